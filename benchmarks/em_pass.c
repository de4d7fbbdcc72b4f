/* One pass of EM in C: the algorithm of noiseid's kernels (filters/ekf_steps.py, filters/smoother.py and
   estimators/extended_moments.py) with sizes that the compiler knows, for models whose outputs are all measured, whose
   predicted covariance is regular, and whose scheme is Euler's. The model's functions stand in front of this text. */

#define WIDE (2 * NX + NV)

/* Reflections from the left: the first `pivots` columns of A become upper-triangular. */
#define TRIANGULARISE(A, rows, columns, pivots)                                              \
    for (int j = 0; j < MIN(rows, pivots); j++) {                                            \
        double w[columns], below = 0.0, pivot = A[j][j];                                     \
        for (int i = j + 1; i < (rows); i++) below += A[i][j] * A[i][j];                     \
        if (below == 0.0) {                                                                  \
            if (pivot < 0.0) for (int k = j; k < (columns); k++) A[j][k] = -A[j][k];         \
            continue;                                                                        \
        }                                                                                    \
        double norm = sqrt(pivot * pivot + below);                                           \
        double v0 = pivot <= 0.0 ? pivot - norm : -below / (pivot + norm);                   \
        double tau = 2.0 * v0 * v0 / (below + v0 * v0), scale = 1.0 / v0;                    \
        for (int k = 0; k < (columns); k++) w[k] = A[j][k];                                  \
        for (int i = j + 1; i < (rows); i++) {                                               \
            double v = A[i][j] *= scale;                                                     \
            for (int k = j + 1; k < (columns); k++) w[k] += v * A[i][k];                     \
        }                                                                                    \
        A[j][j] = norm;                                                                      \
        for (int k = j + 1; k < (columns); k++) { w[k] *= tau; A[j][k] -= w[k]; }            \
        for (int i = j + 1; i < (rows); i++) {                                               \
            double v = A[i][j];                                                              \
            A[i][j] = 0.0;                                                                   \
            for (int k = j + 1; k < (columns); k++) A[i][k] -= v * w[k];                     \
        }                                                                                    \
    }
#define MIN(a, b) ((a) < (b) ? (a) : (b))

typedef double Vx[NX], Vy[NY], Mxx[NX][NX], Mxv[NX][NV], Mvv[NV][NV], Myx[NY][NX], Myy[NY][NY];

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
    double W[NY][NY + NX] = {0}, Z[NX][NY];
    for (int r = 0; r < NY; r++) for (int c = r; c < NY; c++) W[r][c] = UR[r][c];
    memset(U_out, 0, sizeof(Mxx));
    for (int r = 0; r < NX; r++) {
        for (int c = 0; c < NY; c++) {
            Z[r][c] = 0.0;
            for (int j = r; j < NX; j++) Z[r][c] += U[r][j] * H[c][j];
        }
        for (int c = r; c < NX; c++) U_out[r][c] = U[r][c];
    }
    for (int i = 0; i < NY; i++) {
        Vx length;
        double pivot = W[i][i], total = pivot * pivot;
        for (int r = NX - 1; r >= 0; r--) length[r] = sqrt(total += Z[r][i] * Z[r][i]);
        for (int r = NX - 1; r >= 0; r--) {
            if (Z[r][i] == 0.0 || length[r] == 0.0) continue;
            double scale = 1.0 / length[r], cosine = scale * pivot, sine = scale * Z[r][i];
            pivot = length[r];
            for (int c = r; c < NX; c++) {
                double above = W[i][NY + c], below = U_out[r][c];
                W[i][NY + c] = cosine * above + sine * below;
                U_out[r][c] = cosine * below - sine * above;
            }
            for (int c = i + 1; c < NY; c++) {
                double above = W[i][c], below = Z[r][c];
                W[i][c] = cosine * above + sine * below;
                Z[r][c] = cosine * below - sine * above;
            }
        }
        W[i][i] = pivot;
    }
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

static void rows_of_joint(Mxx U, Mvv UQ, Mxx F, Mxv G, double *W, int width) {
    for (int c = 0; c < NX; c++) {
        for (int r = 0; r < NX; r++) {
            double total = 0.0;
            for (int j = r; j < NX; j++) total += U[r][j] * F[c][j];
            W[r * width + c] = total;
        }
        for (int r = 0; r < NV; r++) {
            double total = 0.0;
            for (int j = r; j < NV; j++) total += UQ[r][j] * G[c][j];
            W[(NX + r) * width + c] = total;
        }
    }
}

/* U_pred, gain and C of one step from [U F', U, 0; UQ G', 0, UQ]. */
static void predict_joint(Mxx U, Mvv UQ, Mxx F, Mxv G, Mxx U_pred, double (*gain)[NX], double (*C)[NX + NV]) {
    double W[NX + NV][WIDE] = {0};
    rows_of_joint(U, UQ, F, G, &W[0][0], WIDE);
    for (int r = 0; r < NX; r++) for (int c = r; c < NX; c++) W[r][NX + c] = U[r][c];
    for (int r = 0; r < NV; r++) for (int c = r; c < NV; c++) W[NX + r][2 * NX + c] = UQ[r][c];
    TRIANGULARISE(W, NX + NV, WIDE, NX)
    for (int r = 0; r < NX; r++) memcpy(U_pred[r], W[r], sizeof(Vx));
    for (int i = NX - 1; i >= 0; i--)
        for (int j = 0; j < NX + NV; j++) {
            double total = W[i][NX + j];
            for (int c = i + 1; c < NX; c++) total -= W[i][c] * gain[j][c];
            gain[j][i] = total / W[i][i];
        }
    for (int r = 0; r < NV; r++) memcpy(C[r], &W[NX + r][NX], sizeof(double) * (NX + NV));
}

/* L = F2^+ by a triangularisation of [F2, I]. */
static void left_inverse(Mxv F2, double (*L)[NX]) {
    double A[NX][NV + NX] = {0};
    for (int i = 0; i < NX; i++) {
        memcpy(A[i], F2[i], sizeof F2[i]);
        A[i][NV + i] = 1.0;
    }
    TRIANGULARISE(A, NX, NV + NX, NV)
    for (int r = 0; r < NX; r++)
        for (int i = NV - 1; i >= 0; i--) {
            double total = A[i][NV + r];
            for (int j = i + 1; j < NV; j++) total -= A[i][j] * L[j][r];
            L[i][r] = total / A[i][i];
        }
}

/* Add what one step gives to the moment of the process noise. */
static void add_moment(Mxx J1, Mxv F2, Vx r, Mxx U_next, double (*gain)[NX], double (*C)[NX + NV], Mvv total) {
    double L[NV][NX], W[NV + NX + 1][NV];
    left_inverse(F2, L);
    for (int c = 0; c < NV; c++) {
        Vx B = {0}, D;
        memcpy(D, L[c], sizeof D);
        for (int i = 0; i < NX; i++) for (int j = 0; j < NX; j++) B[j] += L[c][i] * J1[i][j];
        for (int i = 0; i < NX; i++) for (int j = 0; j < NX; j++) D[j] -= B[i] * gain[i][j];
        for (int q = 0; q < NV; q++) {
            W[q][c] = 0.0;
            for (int j = 0; j < NX; j++) W[q][c] -= C[q][j] * B[j];
        }
        for (int q = 0; q < NX; q++) {
            W[NV + q][c] = 0.0;
            for (int j = q; j < NX; j++) W[NV + q][c] += U_next[q][j] * D[j];
        }
        W[NV + NX][c] = 0.0;
        for (int j = 0; j < NX; j++) W[NV + NX][c] += L[c][j] * r[j];
    }
    for (int q = 0; q < NV + NX + 1; q++)
        for (int i = 0; i < NV; i++) for (int j = 0; j < NV; j++) total[i][j] += W[q][i] * W[q][j];
}

/* Filter, and the way back with the sum of E[v v' | y] (NV, NV) in sum_v. Returns the log-likelihood. */
double em_pass(long N, double *p, double *dt, double *u, long nu, double *y, double *m0, double *U0, double *Q_factor,
               double *R_factor, Vx *m_pred, Vx *m_filt, double (*gain)[NX + NV][NX], double (*C)[NV][NX + NV],
               double *sum_v) {
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
        double S[NV + NX][NX];
        for (int i = 0; i < NX; i++) {
            m[i] = m_filt[k][i];
            for (int j = 0; j < NX; j++) m[i] += gain[k][i][j] * (m_next[j] - m_pred[k + 1][j]);
        }
        step(m, u + k * nu, dt[k], p, next, F, G);
        for (int i = 0; i < NX; i++) r[i] = m_next[i] - next[i];
        add_moment(F, G, r, U_next, gain[k], C[k], total);
        for (int i = 0; i < NX; i++) {
            for (int q = 0; q < NV; q++) S[q][i] = C[k][q][i];
            for (int q = 0; q < NX; q++) {
                double sum = 0.0;
                for (int j = q; j < NX; j++) sum += U_next[q][j] * gain[k][i][j];
                S[NV + q][i] = sum;
            }
        }
        TRIANGULARISE(S, NV + NX, NX, NX)
        memcpy(U_next, S, sizeof U_next);
        memcpy(m_next, m, sizeof m_next);
    }
    memcpy(sum_v, total, sizeof total);
    return loglik;
}
