/* The second-order steps of "lie-midpoint", "energy-momentum" and "split" written by hand, for one body and its moment along the
 * moving directors: what the compiled kernels of the package are held to. Each step is solved to round-off and stored:
 * 9 directors, 9 director velocities, the multipliers. Equations: the docstrings of nontwist.integrators.
 *
 * fixed: the body may not turn about its third direction. moments: (n, 3) at the middles of the steps, or NULL.
 * multipliers may be NULL. All return the number of steps done. */
#include <math.h>

#define EPS 2.220446049250313e-16

static inline void cross(const double *a, const double *b, double *c) {
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Solve K x = b, or with `fixed` its first two rows for x[2] = 0. */
static inline void solve(const double K[3][3], const double *b, int fixed, double *x) {
    if (fixed) {
        double f = 1.0 / (K[0][0] * K[1][1] - K[0][1] * K[1][0]);
        x[0] = f * (K[1][1] * b[0] - K[0][1] * b[1]);
        x[1] = f * (K[0][0] * b[1] - K[1][0] * b[0]);
        x[2] = 0.0;
        return;
    }
    double c0[3], c1[3], c2[3];
    cross(K[1], K[2], c0);
    cross(K[2], K[0], c1);
    cross(K[0], K[1], c2);
    double f = 1.0 / dot(K[0], c0);
    for (int i = 0; i < 3; i++)
        x[i] = f * (b[0] * c0[i] + b[1] * c1[i] + b[2] * c2[i]);
}

/* p <- p (1, a) / |(1, a)|, normalised; the columns of its rotation are the directors, written as rows. */
static inline void turn(double *p, const double *a, double *q) {
    double w = p[0] - p[1] * a[0] - p[2] * a[1] - p[3] * a[2];
    double x = p[1] + p[0] * a[0] + p[2] * a[2] - p[3] * a[1];
    double y = p[2] + p[0] * a[1] + p[3] * a[0] - p[1] * a[2];
    double z = p[3] + p[0] * a[2] + p[1] * a[1] - p[2] * a[0];
    double f = 1.0 / sqrt(w * w + x * x + y * y + z * z);
    p[0] = w *= f, p[1] = x *= f, p[2] = y *= f, p[3] = z *= f;
    q[0] = 1 - 2 * (y * y + z * z), q[3] = 2 * (x * y - w * z), q[6] = 2 * (x * z + w * y);
    q[1] = 2 * (x * y + w * z), q[4] = 1 - 2 * (x * x + z * z), q[7] = 2 * (y * z - w * x);
    q[2] = 2 * (x * z - w * y), q[5] = 2 * (y * z + w * x), q[8] = 1 - 2 * (x * x + y * y);
}

/* Whether Newton's iteration is done: nothing more to gain, or the next increment is below round-off. */
static inline int done(const double *d, const double *x, double *previous, int iteration) {
    double size = fabs(d[0]) + fabs(d[1]) + fabs(d[2]), level = fabs(x[0]) + fabs(x[1]) + fabs(x[2]);
    double rate = iteration ? size / *previous : 0.0;
    *previous = size;
    return size <= EPS * level || (rate > 0.5 && size <= 1e-9 * level) ||
           (iteration && size * rate * rate <= 0.1 * EPS * level);
}

/* Non-twisting body: Π += h M, Λ <- Λ exp(h Ŵ) with W = J⁻¹ Π in the plane, Π at the middle of the step. */
long split(long n, double h, const double *J, int fixed, const double *moments, double *p, double *W,
           double *directors, double *velocities, double *multipliers) {
    double det = J[0] * J[4] - J[1] * J[3], a = J[4] / det, b = -J[1] / det, c = J[0] / det;
    double X = J[0] * W[0] + J[1] * W[1], Y = J[3] * W[0] + J[4] * W[1];
    for (long k = 0; k < n; k++) {
        const double none[3] = {0, 0, 0}, *M = moments ? moments + 3 * k : none;
        double x = X + 0.5 * h * M[0], y = Y + 0.5 * h * M[1], w[2] = {a * x + b * y, b * x + c * y};
        double half = 0.5 * h * sqrt(w[0] * w[0] + w[1] * w[1]);
        double f = half > 1e-8 ? 0.5 * h * tan(half) / half : 0.5 * h;
        double v[3] = {f * w[0], f * w[1], 0.0}, *q = directors + 9 * k, *u = velocities + 9 * k;
        turn(p, v, q);
        X += h * M[0], Y += h * M[1];
        W[0] = a * X + b * Y, W[1] = b * X + c * Y;
        for (int j = 0; j < 3; j++) {
            u[j] = -W[1] * q[6 + j];
            u[3 + j] = W[0] * q[6 + j];
            u[6 + j] = W[1] * q[j] - W[0] * q[3 + j];
        }
        if (multipliers)
            multipliers[k] = x * w[1] - y * w[0] + M[2];
    }
    return n;
}

long lie_midpoint(long n, double h, const double *J, int fixed, const double *moments, double *p, double *W,
                  double *directors, double *velocities, double *multipliers) {
    double y[3] = {0, 0, 0};
    for (long k = 0; k < n; k++) {
        const double none[3] = {0, 0, 0}, *M = moments ? moments + 3 * k : none;
        double Om[3], L[3], r[3], d[3], K[3][3], previous = 0.0;
        int iteration = 0;
        for (;; iteration++) {
            if (iteration == 40)
                return k;
            for (int i = 0; i < 3; i++)
                Om[i] = W[i] + y[i];
            for (int i = 0; i < 3; i++)
                L[i] = dot(J + 3 * i, Om);
            cross(L, Om, r);
            for (int i = 0; i < 3; i++)
                r[i] = h * (r[i] + M[i]) - 2 * dot(J + 3 * i, y);
            double size = fabs(r[0]) + fabs(r[1]) + (fixed ? 0.0 : fabs(r[2]));
            if (size == 0.0)
                break;
            for (int j = 0; j < 3; j++) { /* d(JΩ × Ω)/dΩ_j = J_j × Ω + JΩ × e_j */
                double c[3];
                cross(J + 3 * j, Om, c);
                c[(j + 1) % 3] += L[(j + 2) % 3];
                c[(j + 2) % 3] -= L[(j + 1) % 3];
                for (int i = 0; i < 3; i++)
                    K[i][j] = 2 * J[3 * i + j] - h * c[i];
            }
            solve(K, r, fixed, d);
            for (int i = 0; i < 3; i++)
                y[i] += d[i];
            for (int i = 0; i < 3; i++)
                Om[i] = W[i] + y[i];
            if (done(d, Om, &previous, iteration))
                break;
        }
        double a[3] = {0.5 * h * Om[0], 0.5 * h * Om[1], 0.5 * h * Om[2]};
        if (multipliers && fixed) {
            for (int i = 0; i < 3; i++)
                L[i] = dot(J + 3 * i, Om);
            cross(L, Om, r);
            multipliers[k] = r[2] + M[2] - 2 / h * dot(J + 6, y);
        }
        for (int i = 0; i < 3; i++)
            W[i] += 2 * y[i];
        double *q = directors + 9 * k, *v = velocities + 9 * k;
        turn(p, a, q);
        for (int x = 0; x < 3; x++) { /* d_i' = W × d_i */
            v[x] = W[2] * q[3 + x] - W[1] * q[6 + x];
            v[3 + x] = W[0] * q[6 + x] - W[2] * q[x];
            v[6 + x] = W[1] * q[x] - W[0] * q[3 + x];
        }
    }
    return n;
}

/* V: (3, 3) director velocities in the body; E: Euler inertia. With P = E V, a = h Ω / 2, s = 1 / (1 + a²) the equations
 * are Σ e_i × [Σ E_ij (y × e_j - N_j) + a × P_i] = (h/4) [(1 + s) B + s (a·B) a], V_j = W × e_j + N_j, Ω = W + y. */
long energy_momentum(long n, double h, const double *E, int fixed, const double *moments, double *p, double *V,
                     double *directors, double *velocities, double *multipliers) {
    double trace = E[0] + E[4] + E[8], yl[3] = {0, 0, 0};
    for (long k = 0; k < n; k++) {
        const double *B = moments ? moments + 3 * k : 0;
        double W[3] = {(V[5] - V[7]) / 2, (V[6] - V[2]) / 2, (V[1] - V[3]) / 2};
        double P[9], N[9], X[9], K0[3][3], r0[3], y[3], a[3], d[3], s = 1.0, previous = 0.0;
        for (int i = 0; i < 3; i++)
            for (int x = 0; x < 3; x++)
                P[3 * i + x] = E[3 * i] * V[x] + E[3 * i + 1] * V[3 + x] + E[3 * i + 2] * V[6 + x];
        for (int i = 0; i < 3; i++)
            for (int x = 0; x < 3; x++)
                N[3 * i + x] = (V[3 * i + x] + V[3 * x + i]) / 2;
        double tau = P[0] + P[4] + P[8], G0[3][3], EN[9];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                G0[i][j] = 0.5 * h * ((i == j ? tau : 0.0) - P[3 * j + i]); /* a -> Σ e_i × (a × P_i) */
                K0[i][j] = (i == j ? trace : 0.0) - E[3 * i + j] + G0[i][j];
                EN[3 * i + j] = E[3 * i] * N[j] + E[3 * i + 1] * N[3 + j] + E[3 * i + 2] * N[6 + j];
            }
        double z[3] = {EN[5] - EN[7], EN[6] - EN[2], EN[1] - EN[3]};
        for (int i = 0; i < 3; i++)
            r0[i] = z[i] - dot(G0[i], W);
        y[0] = yl[0], y[1] = yl[1], y[2] = fixed ? -W[2] : yl[2];
        for (int iteration = 0;; iteration++) {
            if (iteration == 40)
                return k;
            double K[3][3], r[3], Om[3];
            for (int i = 0; i < 3; i++) {
                r[i] = r0[i] - dot(K0[i], y);
                for (int j = 0; j < 3; j++)
                    K[i][j] = K0[i][j];
            }
            if (B) {
                for (int i = 0; i < 3; i++)
                    a[i] = 0.5 * h * (W[i] + y[i]);
                s = 1.0 / (1.0 + dot(a, a));
                double aB = dot(a, B), ds = -2 * s * s;
                for (int i = 0; i < 3; i++) {
                    r[i] += 0.25 * h * ((1 + s) * B[i] + s * aB * a[i]);
                    for (int j = 0; j < 3; j++)
                        K[i][j] -= 0.125 * h * h *
                                   ((B[i] + aB * a[i]) * ds * a[j] + s * (a[i] * B[j] + (i == j ? aB : 0.0)));
                }
            }
            solve(K, r, fixed, d);
            for (int i = 0; i < 3; i++)
                y[i] += d[i], Om[i] = W[i] + y[i];
            if (!B || done(d, Om, &previous, iteration))
                break;
        }
        for (int i = 0; i < 3; i++)
            a[i] = 0.5 * h * (W[i] + y[i]), yl[i] = y[i];
        s = 1.0 / (1.0 + dot(a, a));
        double M[3][3]; /* s (I + â + a aᵀ) */
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                M[i][j] = s * ((i == j) + a[i] * a[j]);
        M[0][1] -= s * a[2], M[1][0] += s * a[2];
        M[0][2] += s * a[1], M[2][0] -= s * a[1];
        M[1][2] -= s * a[0], M[2][1] += s * a[0];
        /* Y_j = y × e_j - N_j, and X_j = (I - â)(u_j - V_j) = Y_j + a × V_j */
        double Y[9] = {-N[0], y[2] - N[1], -y[1] - N[2], -y[2] - N[3], -N[4], y[0] - N[5], y[1] - N[6], -y[0] - N[7], -N[8]};
        for (int j = 0; j < 3; j++) {
            cross(a, V + 3 * j, X + 3 * j);
            for (int x = 0; x < 3; x++)
                X[3 * j + x] += Y[3 * j + x];
        }
        if (multipliers) {
            double L[9];
            for (int i = 0; i < 3; i++)
                for (int x = 0; x < 3; x++)
                    L[3 * i + x] = -2 / h * (E[3 * i] * X[x] + E[3 * i + 1] * X[3 + x] + E[3 * i + 2] * X[6 + x]);
            if (B) /* (I - â) f_i = s/2 (I - â²)(B × e_i) */
                for (int i = 0; i < 3; i++) {
                    double e[3] = {i == 0, i == 1, i == 2}, c[3], ac[3], aac[3];
                    cross(B, e, c);
                    cross(a, c, ac);
                    cross(a, ac, aac);
                    for (int x = 0; x < 3; x++)
                        L[3 * i + x] += 0.5 * s * (c[x] - aac[x]);
                }
            double *out = multipliers + (6 + fixed) * k;
            out[0] = L[0], out[1] = L[4], out[2] = L[8];
            out[3] = 0.5 * (L[5] + L[7]), out[4] = 0.5 * (L[2] + L[6]), out[5] = 0.5 * (L[1] + L[3]);
            if (fixed)
                out[6] = L[1] - L[3];
        }
        /* V_i in the new frame: V_i + 2 Mᵀ Y_i */
        for (int i = 0; i < 3; i++)
            for (int x = 0; x < 3; x++)
                V[3 * i + x] += 2 * (M[0][x] * Y[3 * i] + M[1][x] * Y[3 * i + 1] + M[2][x] * Y[3 * i + 2]);
        double *q = directors + 9 * k, *v = velocities + 9 * k;
        turn(p, a, q);
        for (int i = 0; i < 3; i++)
            for (int x = 0; x < 3; x++)
                v[3 * i + x] = V[3 * i] * q[x] + V[3 * i + 1] * q[3 + x] + V[3 * i + 2] * q[6 + x];
    }
    return n;
}
