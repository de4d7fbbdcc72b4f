/* One pass of EM in C: the algorithm of noiseid's kernels (filters/ekf_steps.py, filters/smoother.py and
   estimators/extended_moments.py) on the same blocks of eight columns, with sizes that the compiler knows, for models
   whose outputs are all measured, whose predicted covariance is regular, and whose scheme is Euler's. The model's
   functions stand in front of this text. */

typedef double eight __attribute__((vector_size(64), aligned(8), may_alias));
#define BLOCK(place) (*(eight *)(place))
#define BLOCKS(columns) (((columns) + 7) / 8 * 8)
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define WIDE (2 * NX + NV)

/* Reflections from the left: the first `pivots` columns of A become upper-triangular; A has whole blocks. */
#define TRIANGULARISE(A, rows, columns, pivots)                                              \
    for (int j = 0; j < MIN(rows, pivots); j++) {                                            \
        double below = 0.0, pivot = A[j][j];                                                 \
        for (int i = j + 1; i < (rows); i++) below += A[i][j] * A[i][j];                     \
        if (below == 0.0) {                                                                  \
            if (pivot < 0.0) for (int k = j; k < (columns); k++) A[j][k] = -A[j][k];         \
            continue;                                                                        \
        }                                                                                    \
        double norm = sqrt(pivot * pivot + below);                                           \
        double v0 = pivot <= 0.0 ? pivot - norm : -below / (pivot + norm);                   \
        double tau = 2.0 * v0 * v0 / (below + v0 * v0), scale = 1.0 / v0;                    \
        for (int c = (columns) - 8; c >= j / 8 * 8; c -= 8) {                                \
            eight sums = BLOCK(&A[j][c]);                                                    \
            for (int i = j + 1; i < (rows); i++) sums += scale * A[i][j] * BLOCK(&A[i][c]);  \
            sums *= tau;                                                                     \
            BLOCK(&A[j][c]) -= sums;                                                         \
            for (int i = j + 1; i < (rows); i++) {                                           \
                double factor = scale * A[i][j];                                             \
                BLOCK(&A[i][c]) -= factor * sums;                                            \
            }                                                                                \
        }                                                                                    \
        A[j][j] = norm;                                                                      \
    }                                                                                        \
    for (int j = 0; j < MIN(rows, pivots); j++) for (int i = j + 1; i < (rows); i++) A[i][j] = 0.0;

/* W = U B of an upper triangle U, in whole blocks. */
#define UPPER_TIMES(U, n, B, columns, W, row)                                                \
    for (int c = 0; c < BLOCKS(columns); c += 8)                                             \
        for (int r = 0; r < (n); r++) {                                                      \
            eight sums = U[r][r] * BLOCK(&B[r][c]);                                          \
            for (int j = r + 1; j < (n); j++) sums += U[r][j] * BLOCK(&B[j][c]);             \
            BLOCK(&W[(row) + r][c]) = sums;                                                  \
        }

/* Solve the first n columns of an upper triangle for those from `first` on, in place. */
#define BACK_SUBSTITUTE(A, n, first, columns)                                                \
    for (int i = (n) - 1; i >= 0; i--)                                                       \
        for (int c = first; c < (first) + BLOCKS(columns); c += 8) {                         \
            eight sums = BLOCK(&A[i][c]);                                                    \
            for (int j = i + 1; j < (n); j++) sums -= A[i][j] * BLOCK(&A[j][c]);             \
            BLOCK(&A[i][c]) = 1.0 / A[i][i] * sums;                                          \
        }

typedef double Vx[NX], Vy[NY], Mxx[NX][NX], Mxv[NX][NV], Mvv[NV][NV], Myx[NY][NX], Myy[NY][NY];
typedef double Gain[NX][BLOCKS(NX + NV)], Left[NV][BLOCKS(NX + NV)], Bxv[NX][BLOCKS(NV)];

static void step(double *x, double *u, double dt, double *p, double *next, Mxx F, Mxv G) {
    drift_jacobian(x, u, p, next, &F[0][0], &G[0][0]);
    for (int i = 0; i < NX; i++) {
        next[i] = x[i] + dt * next[i];
        for (int j = 0; j < NX; j++) F[i][j] *= dt;
        F[i][i] += 1.0;
        for (int j = 0; j < NV; j++) G[i][j] *= dt;
    }
}

static double update(double *m, Mxx U, Myx H, double *e, Myy UR, double *m_out, Mxx U_out) {
    double W[NY + NX][BLOCKS(NY + BLOCKS(NX))] = {0}, Ht[NX][BLOCKS(NY)] = {0};
    for (int r = 0; r < NY; r++) for (int c = r; c < NY; c++) W[r][c] = UR[r][c];
    for (int i = 0; i < NY; i++) for (int c = 0; c < NX; c++) Ht[c][i] = H[i][c];
    UPPER_TIMES(U, NX, Ht, NY, W, NY)
    for (int r = 0; r < NX; r++) memcpy(&W[NY + r][NY], U[r], sizeof(Vx));
    for (int i = 0; i < NY; i++) {
        Vx cosine, sine;
        double pivot = W[i][i], total = pivot * pivot;
        for (int r = NX - 1; r >= 0; r--) {
            double below = W[NY + r][i];
            total += below * below;
            cosine[r] = 1.0, sine[r] = 0.0;
            if (below != 0.0 && total != 0.0) {
                double length = sqrt(total), scale = 1.0 / length;
                cosine[r] = scale * pivot, sine[r] = scale * below;
                pivot = length;
            }
        }
        for (int c = i / 8 * 8; c < BLOCKS(NY + NX); c += 8) {
            eight above = BLOCK(&W[i][c]);
            for (int r = NX - 1; r >= 0; r--) {
                eight below = BLOCK(&W[NY + r][c]);
                BLOCK(&W[NY + r][c]) = cosine[r] * below - sine[r] * above;
                above = cosine[r] * above + sine[r] * below;
            }
            BLOCK(&W[i][c]) = above;
        }
        W[i][i] = pivot;
    }
    for (int r = 0; r < NX; r++) memcpy(U_out[r], &W[NY + r][NY], sizeof(Vx));
    double loglik = -0.5 * NY * 1.8378770664093453;
    for (int i = 0; i < NY; i++) {
        for (int j = 0; j < i; j++) e[i] -= W[j][i] * e[j];
        e[i] /= W[i][i];
        loglik -= 0.5 * e[i] * e[i] + log(W[i][i]);
    }
    for (int c = 0; c < NX; c++) {
        m_out[c] = m[c];
        for (int i = 0; i < NY; i++) m_out[c] += W[i][NY + c] * e[i];
    }
    return loglik;
}

/* U_pred, the transposed gain and C of one step from [U F', U, 0; UQ G', 0, UQ]. */
static void predict_joint(Mxx U, Mvv UQ, Mxx F, Mxv G, Mxx U_pred, Gain gain, Left C) {
    double W[NX + NV][MAX(BLOCKS(WIDE), NX + BLOCKS(NX + NV))] = {0};
    double Ft[NX][BLOCKS(NX)] = {0}, Gt[NV][BLOCKS(NX)] = {0};
    for (int r = 0; r < NX; r++) for (int c = 0; c < NX; c++) Ft[c][r] = F[r][c];
    for (int r = 0; r < NX; r++) for (int c = 0; c < NV; c++) Gt[c][r] = G[r][c];
    UPPER_TIMES(U, NX, Ft, NX, W, 0)
    UPPER_TIMES(UQ, NV, Gt, NX, W, NX)
    for (int r = 0; r < NX; r++) memcpy(&W[r][NX], U[r], sizeof(Vx));
    for (int r = 0; r < NV; r++) memcpy(&W[NX + r][2 * NX], UQ[r], sizeof UQ[r]);
    TRIANGULARISE(W, NX + NV, BLOCKS(WIDE), NX)
    for (int r = 0; r < NX; r++) memcpy(U_pred[r], W[r], sizeof(Vx));
    for (int r = 0; r < NV; r++) memcpy(C[r], &W[NX + r][NX], sizeof C[r]);
    BACK_SUBSTITUTE(W, NX, NX, NX + NV)
    for (int r = 0; r < NX; r++) memcpy(gain[r], &W[r][NX], sizeof gain[r]);
}

/* Add what one step gives to the moment of the process noise; joint is the factor of (x_k, v_k). */
static void add_moment(Mxx J1, Mxv F2, Vx r, Mxx U_next, double (*joint)[BLOCKS(NX + NV)], Mvv total) {
    double A[NX][MAX(BLOCKS(NV + NX), NV + BLOCKS(NX))] = {0}, W[NV + NX][BLOCKS(NV)] = {0};
    Bxv Lt = {0}, B = {0};
    int rows = 0, entered[NX];  // the states that noise enters
    for (int i = 0; i < NX; i++) {
        double size = 0.0;
        for (int c = 0; c < NV; c++) size += fabs(F2[i][c]);
        if (size == 0.0) continue;
        memcpy(A[rows], F2[i], sizeof F2[i]);
        A[rows][NV + rows] = 1.0;
        entered[rows++] = i;
    }
    TRIANGULARISE(A, rows, MIN(BLOCKS(NV + NX), (NV + rows + 7) / 8 * 8), NV)
    BACK_SUBSTITUTE(A, NV, NV, rows)
    for (int i = 0; i < rows; i++) for (int c = 0; c < NV; c++) Lt[entered[i]][c] = A[c][NV + i];
    UPPER_TIMES(U_next, NX, Lt, NV, W, NV)
    for (int c = 0; c < BLOCKS(NV); c += 8) {
        for (int j = 0; j < NX; j++) {
            eight sums = -J1[0][j] * BLOCK(&Lt[0][c]);
            for (int i = 1; i < NX; i++) sums -= J1[i][j] * BLOCK(&Lt[i][c]);
            BLOCK(&B[j][c]) = sums;
        }
        for (int q = 0; q < NV + NX; q++) {
            eight sums = BLOCK(&W[q][c]);
            for (int j = 0; j < NX; j++) sums += joint[q][j] * BLOCK(&B[j][c]);
            BLOCK(&W[q][c]) = sums;
        }
    }
    double v[NV] = {0};
    for (int c = 0; c < NV; c++) for (int i = 0; i < rows; i++) v[c] += A[c][NV + i] * r[entered[i]];
    for (int i = 0; i < NV; i++) {
        double row[BLOCKS(NV)];
        for (int c = 0; c < BLOCKS(NV); c += 8) {
            eight sums = W[0][i] * BLOCK(&W[0][c]);
            for (int q = 1; q < NV + NX; q++) sums += W[q][i] * BLOCK(&W[q][c]);
            BLOCK(&row[c]) = sums;
        }
        for (int j = 0; j < NV; j++) total[i][j] += v[i] * v[j] + row[j];
    }
}

/* Filter, and the way back with the sum of E[v v' | y] (NV, NV) in sum_v. Returns the log-likelihood. */
double em_pass(long N, double *p, double *dt, double *u, long nu, double *y, double *m0, double *U0, double *Q_factor,
               double *R_factor, Vx *m_pred, Vx *m_filt, Gain *gain, Left *C, double *sum_v) {
    Mvv UQ, total = {0};
    Myy UR;
    Mxx U_pred, U_filt, F;
    Mxv G;
    double loglik = 0.0;
    memcpy(UQ, Q_factor, sizeof UQ);
    memcpy(UR, R_factor, sizeof UR);
    memcpy(m_pred[0], m0, sizeof(Vx));
    memcpy(U_pred, U0, sizeof U_pred);
    for (long k = 0; k < N; k++) {
        Vy e;
        Myx H;
        output_jacobian(m_pred[k], u + k * nu, p, e, &H[0][0]);
        for (int i = 0; i < NY; i++) e[i] = y[k * NY + i] - e[i];
        loglik += update(m_pred[k], U_pred, H, e, UR, m_filt[k], U_filt);
        if (k == N - 1) break;
        step(m_filt[k], u + k * nu, dt[k], p, m_pred[k + 1], F, G);
        predict_joint(U_filt, UQ, F, G, U_pred, gain[k], C[k]);
    }
    Vx m_next, m, next, r;
    Mxx U_next;
    memcpy(m_next, m_filt[N - 1], sizeof m_next);
    memcpy(U_next, U_filt, sizeof U_next);
    for (long k = N - 2; k >= 0; k--) {
        double joint[NV + NX][BLOCKS(NX + NV)];
        memcpy(m, m_filt[k], sizeof m);
        for (int j = 0; j < NX; j++) {
            double shift = m_next[j] - m_pred[k + 1][j];
            for (int i = 0; i < NX; i++) m[i] += gain[k][j][i] * shift;
        }
        step(m, u + k * nu, dt[k], p, next, F, G);
        for (int i = 0; i < NX; i++) r[i] = m_next[i] - next[i];
        memcpy(joint, C[k], sizeof C[k]);
        UPPER_TIMES(U_next, NX, gain[k], NX + NV, joint, NV)
        add_moment(F, G, r, U_next, joint, total);
        TRIANGULARISE(joint, NV + NX, BLOCKS(NX), NX)
        for (int q = 0; q < NX; q++) memcpy(U_next[q], joint[q], sizeof(Vx));
        memcpy(m_next, m, sizeof m_next);
    }
    memcpy(sum_v, total, sizeof total);
    return loglik;
}
