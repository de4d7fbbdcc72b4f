/* One pass of EM in C: the algorithm of noiseid's kernels (filters/ekf.py, filters/smoother.py and
   estimators/process_moment.py) with sizes that the compiler knows, for models whose outputs are all measured, whose
   predicted covariance is regular, and whose scheme is Euler's. The model's functions stand in front of this text. */

#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define WIDE (2 * NX + NV)
#define ROWS MAX(NX + NV, NX + NY)

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
    double W[NY + NX][NY + NX] = {0};
    for (int r = 0; r < NY; r++) for (int c = r; c < NY; c++) W[r][c] = UR[r][c];
    for (int r = 0; r < NX; r++) {
        for (int c = 0; c < NY; c++) {
            double total = 0.0;
            for (int j = r; j < NX; j++) total += U[r][j] * H[c][j];
            W[NY + r][c] = total;
        }
        for (int c = r; c < NX; c++) W[NY + r][NY + c] = U[r][c];
    }
    TRIANGULARISE(W, NY + NX, NY + NX, NY + NX)
    double loglik = -0.5 * NY * 1.8378770664093453;
    for (int i = 0; i < NY; i++) {
        for (int j = 0; j < i; j++) e[i] -= W[j][i] * e[j];
        e[i] /= W[i][i];
        loglik -= 0.5 * e[i] * e[i] + log(W[i][i]);
    }
    for (int c = 0; c < NX; c++) {
        m_out[c] = m[c];
        for (int i = 0; i < NY; i++) m_out[c] += W[i][NY + c] * e[i];
        for (int r = 0; r < NX; r++) U_out[r][c] = r <= c ? W[NY + r][NY + c] : 0.0;
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

/* Filter, smoother and the process-noise moment; U_v (NV, NV) is its factor. Returns the log-likelihood. */
double em_pass(long N, double *p, double *dt, double *u, long nu, double *y, double *m0, double *U0, double *Q_factor,
               double *R_factor, Vx *m_pred, Mxx *U_pred, Vx *m_filt, Mxx *U_filt, Mxx *F, Mxv *G, Vx *m, Mxx *U,
               double (*gain)[NX + NV][NX], double (*C)[NV][NX + NV], double *U_v) {
    Mvv UQ, total_v = {0};
    Myy UR;
    double loglik = 0.0;
    memcpy(UQ, Q_factor, sizeof UQ);
    memcpy(UR, R_factor, sizeof UR);
    memcpy(m_pred[0], m0, sizeof(Vx));
    memcpy(U_pred[0], U0, sizeof(Mxx));
    for (long k = 0; k < N; k++) {
        Vy e;
        Myx H;
        output_jacobian(m_pred[k], u + k * nu, p, e, &H[0][0]);
        for (int i = 0; i < NY; i++) e[i] = y[k * NY + i] - e[i];
        loglik += update(m_pred[k], U_pred[k], H, e, UR, m_filt[k], U_filt[k]);
        if (k == N - 1) break;
        step(m_filt[k], u + k * nu, dt[k], p, m_pred[k + 1], F[k], G[k]);
        double W[NX + NV][NX];
        rows_of_joint(U_filt[k], UQ, F[k], G[k], &W[0][0], NX);
        TRIANGULARISE(W, NX + NV, NX, NX)
        memcpy(U_pred[k + 1], W, sizeof(Mxx));
    }
    memcpy(m[N - 1], m_filt[N - 1], sizeof(Vx));
    memcpy(U[N - 1], U_filt[N - 1], sizeof(Mxx));
    for (long k = N - 2; k >= 0; k--) {
        double W[NX + NV][WIDE] = {0};
        rows_of_joint(U_filt[k], UQ, F[k], G[k], &W[0][0], WIDE);
        for (int r = 0; r < NX; r++) for (int c = r; c < NX; c++) W[r][NX + c] = U_filt[k][r][c];
        for (int r = 0; r < NV; r++) for (int c = r; c < NV; c++) W[NX + r][2 * NX + c] = UQ[r][c];
        TRIANGULARISE(W, NX + NV, WIDE, NX)
        for (int i = NX - 1; i >= 0; i--)
            for (int j = 0; j < NX + NV; j++) {
                double total = W[i][NX + j];
                for (int c = i + 1; c < NX; c++) total -= W[i][c] * gain[k][j][c];
                gain[k][j][i] = total / W[i][i];
            }
        for (int r = 0; r < NV; r++) memcpy(C[k][r], &W[NX + r][NX], sizeof(double) * (NX + NV));
        double S[NV + NX][NX];
        for (int i = 0; i < NX; i++) {
            m[k][i] = m_filt[k][i];
            for (int j = 0; j < NX; j++) m[k][i] += gain[k][i][j] * (m[k + 1][j] - m_pred[k + 1][j]);
            for (int r = 0; r < NV; r++) S[r][i] = C[k][r][i];
            for (int r = 0; r < NX; r++) {
                double total = 0.0;
                for (int j = r; j < NX; j++) total += U[k + 1][r][j] * gain[k][i][j];
                S[NV + r][i] = total;
            }
        }
        TRIANGULARISE(S, NV + NX, NX, NX)
        memcpy(U[k], S, sizeof(Mxx));
    }
    for (long k = 0; k < N - 1; k++) {
        Vx next;
        Mxx J1, D;
        double L[NX][2 * NV + NX + 1], W[2 * NV + NX + 1][NV];
        Mxv F2;
        step(m[k], u + k * nu, dt[k], p, next, J1, F2);
        for (int i = 0; i < NX; i++) {
            for (int c = 0; c < NX; c++) D[i][c] = i == c;
            for (int j = 0; j < NX; j++) for (int c = 0; c < NX; c++) D[i][c] -= J1[i][j] * gain[k][j][c];
        }
        for (int i = 0; i < NX; i++) {
            for (int c = 0; c < NV; c++) L[i][c] = F2[i][c];
            for (int r = 0; r < NV; r++) {
                double total = 0.0;
                for (int j = 0; j < NX; j++) total -= C[k][r][j] * J1[i][j];
                L[i][NV + r] = total;
            }
            for (int r = 0; r < NX; r++) {
                double total = 0.0;
                for (int j = r; j < NX; j++) total += U[k + 1][r][j] * D[i][j];
                L[i][2 * NV + r] = total;
            }
            L[i][2 * NV + NX] = m[k + 1][i] - next[i];
        }
        TRIANGULARISE(L, NX, 2 * NV + NX + 1, NV)
        for (int r = 0; r < NV + NX + 1; r++)
            for (int i = NV - 1; i >= 0; i--) {
                double total = L[i][NV + r];
                for (int j = i + 1; j < NV; j++) total -= L[i][j] * W[NV + r][j];
                W[NV + r][i] = total / L[i][i];
            }
        memcpy(W, total_v, sizeof total_v);
        TRIANGULARISE(W, 2 * NV + NX + 1, NV, NV)
        memcpy(total_v, W, sizeof total_v);
    }
    memcpy(U_v, total_v, sizeof total_v);
    return loglik;
}
