/* The whole work in C, dense: every point against every limb, float32, written so that the compiler vectorises over
   points. A block of points stays in the first-level cache while all limbs pass over it. */
#include <math.h>
#include <string.h>

#define BLOCK 128
#define MOST 64 /* limbs */

typedef struct {
  float r[9], b[3]; /* limb point = r (world point) + b */
  float ia0, ib0, ia1, ib1, length, length2;
} Limb;

static void assign(const Limb *limbs, int count, const float *restrict x, const float *restrict y,
                   const float *restrict z, int n, float reach2, float *restrict cx, float *restrict cy,
                   float *restrict cz, int *restrict who) {
  float best[BLOCK] __attribute__((aligned(64)));
  for (int i = 0; i < BLOCK; i++) best[i] = reach2, who[i] = count, cx[i] = cy[i] = cz[i] = 0;
  for (int l = 0; l < count; l++) {
    const Limb k = limbs[l];
#pragma GCC ivdep
    for (int i = 0; i < n; i++) {
      float px = k.r[0] * x[i] + k.r[1] * y[i] + k.r[2] * z[i] + k.b[0];
      float py = k.r[3] * x[i] + k.r[4] * y[i] + k.r[5] * z[i] + k.b[1];
      float pz = k.r[6] * x[i] + k.r[7] * y[i] + k.r[8] * z[i] + k.b[2];
      float u = px * px, v = py * py, rho2 = u + v + 1e-12f;
      /* radii of both rims in the point's direction, as multiples of its own */
      float k0 = 1 / sqrtf(u * k.ia0 + v * k.ib0 + 1e-12f), k1 = 1 / sqrtf(u * k.ia1 + v * k.ib1 + 1e-12f);
      float dk = k1 - k0;
      float s = (rho2 * (1 - k0) * dk + pz * k.length) / (rho2 * dk * dk + k.length2);
      s = s < 0 ? 0 : s > 1 ? 1 : s;
      float m = k0 + s * dk, mz = s * k.length, e = 1 - m, g = pz - mz, d2 = rho2 * e * e + g * g;
      int nearer = d2 < best[i];
      best[i] = nearer ? d2 : best[i];
      cx[i] = nearer ? m * px : cx[i];
      cy[i] = nearer ? m * py : cy[i];
      cz[i] = nearer ? mz : cz[i];
      who[i] = nearer ? l : who[i];
    }
  }
}

static void horn(const float m[16], float *R, float *t) {
  double w = m[0] > 1e-6f ? m[0] : 1e-6, s[3][3];
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) s[i][k] = m[4 * i + 5 + k] / w - m[4 * i + 4] / w * (m[k + 1] / w);
  double tr = s[0][0] + s[1][1] + s[2][2], a = s[1][2] - s[2][1], b = s[2][0] - s[0][2], c = s[0][1] - s[1][0];
  double N[4][4] = {{tr, a, b, c},
                    {a, 2 * s[0][0] - tr, s[0][1] + s[1][0], s[0][2] + s[2][0]},
                    {b, s[0][1] + s[1][0], 2 * s[1][1] - tr, s[1][2] + s[2][1]},
                    {c, s[0][2] + s[2][0], s[1][2] + s[2][1], 2 * s[2][2] - tr}};
  /* Newton on the characteristic polynomial, coefficients by Faddeev and LeVerrier; starts above all roots */
  double A[4][4], B[4][4], p[5] = {1};
  memcpy(A, N, sizeof A);
  for (int k = 1; k <= 4; k++) {
    p[k] = -(A[0][0] + A[1][1] + A[2][2] + A[3][3]) / k;
    if (k == 4) break;
    for (int i = 0; i < 4; i++) A[i][i] += p[k];
    for (int i = 0; i < 4; i++)
      for (int j = 0; j < 4; j++)
        B[i][j] = N[i][0] * A[0][j] + N[i][1] * A[1][j] + N[i][2] * A[2][j] + N[i][3] * A[3][j];
    memcpy(A, B, sizeof A);
  }
  double root = sqrt(-1.5 * p[2] + 1e-30);
  for (int i = 0; i < 40; i++) {
    double f = (((root + p[1]) * root + p[2]) * root + p[3]) * root + p[4];
    double d = ((4 * root + 3 * p[1]) * root + 2 * p[2]) * root + p[3], next = root - f / d;
    int done = fabs(next - root) < 1e-12 * root;
    root = next;
    if (done) break;
  }
  /* adjugate of N - root: every column is the eigenvector, the longest one has the most digits */
  double q[4] = {1, 0, 0, 0}, most = 0;
  for (int i = 0; i < 4; i++) N[i][i] -= root;
  for (int j = 0; j < 4; j++) {
    int r[3] = {(j + 1) & 3, (j + 2) & 3, (j + 3) & 3};
    double v[4], n2 = 0;
    for (int i = 0; i < 4; i++) {
      int o[3] = {(i + 1) & 3, (i + 2) & 3, (i + 3) & 3};
      double det = N[r[0]][o[0]] * (N[r[1]][o[1]] * N[r[2]][o[2]] - N[r[1]][o[2]] * N[r[2]][o[1]]) -
                   N[r[0]][o[1]] * (N[r[1]][o[0]] * N[r[2]][o[2]] - N[r[1]][o[2]] * N[r[2]][o[0]]) +
                   N[r[0]][o[2]] * (N[r[1]][o[0]] * N[r[2]][o[1]] - N[r[1]][o[1]] * N[r[2]][o[0]]);
      v[i] = (i + j) & 1 ? -det : det;
      n2 += v[i] * v[i];
    }
    if (n2 > most) most = n2, memcpy(q, v, sizeof q);
  }
  double n = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  double qw = q[0] * n, x = q[1] * n, y = q[2] * n, z = q[3] * n;
  double out[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - qw * z), 2 * (x * z + qw * y),
                   2 * (x * y + qw * z), 1 - 2 * (x * x + z * z), 2 * (y * z - qw * x),
                   2 * (x * z - qw * y), 2 * (y * z + qw * x), 1 - 2 * (x * x + y * y)};
  for (int i = 0; i < 9; i++) R[i] = (float)out[i];
  for (int i = 0; i < 3; i++)
    t[i] = (float)(m[i + 1] / w - (out[3 * i] * m[4] + out[3 * i + 1] * m[8] + out[3 * i + 2] * m[12]) / w);
}

static void band_moments(float M[][16], const float *R, const float *t, int joints, const int *parent, const int *child,
                         const float *pa, const float *pc, const float *weight, float ratio, float least) {
  float n[MOST];
  for (int j = 0; j < MOST; j++) n[j] = M[j][0] > least ? M[j][0] : least;
  for (int j = 0; j < joints; j++)
    for (int e = 0; e < 8; e++) {
      int b = 4 * j + e % 4, own = e < 4 ? parent[j] : child[j], other = e < 4 ? child[j] : parent[j];
      const float *mine = (e < 4 ? pa : pc) + 3 * b, *theirs = (e < 4 ? pc : pa) + 3 * b;
      float w = weight[b] * ratio * n[own];
      float c[4] = {1, mine[0], mine[1], mine[2]}, p[4] = {1};
      for (int i = 0; i < 3; i++) {
        const float *row = R + 9 * other + 3 * i;
        p[i + 1] = row[0] * theirs[0] + row[1] * theirs[1] + row[2] * theirs[2] + t[3 * other + i];
      }
      for (int i = 0; i < 16; i++) M[own][i] += w * c[i / 4] * p[i % 4];
    }
}

/* points [frame][3][n]; R [limb][9] and t [limb][3] are read and written */
void frames(const float *size, float *R, float *t, int count, const int *parent, const int *child, const float *pa,
            const float *pc, const float *weight, int joints, const float *points, int n, int frame_count, int steps,
            float reach, float ratio, float least) {
  for (int f = 0; f < frame_count; f++)
    for (int step = 0; step < steps; step++) {
      const float *x = points + 3L * f * n, *y = x + n, *z = y + n;
      Limb limbs[MOST];
      for (int l = 0; l < count; l++) {
        Limb *k = limbs + l;
        const float *s = size + 5 * l;
        for (int i = 0; i < 3; i++) {
          for (int j = 0; j < 3; j++) k->r[3 * i + j] = R[9 * l + 3 * j + i];
          k->b[i] = -(k->r[3 * i] * t[3 * l] + k->r[3 * i + 1] * t[3 * l + 1] + k->r[3 * i + 2] * t[3 * l + 2]);
        }
        k->ia0 = 1 / (s[0] * s[0]), k->ib0 = 1 / (s[1] * s[1]), k->ia1 = 1 / (s[2] * s[2]), k->ib1 = 1 / (s[3] * s[3]);
        k->length = s[4], k->length2 = s[4] * s[4];
      }
      /* four tables in turn, so that neighbouring points of one limb need not wait for each other */
      float M4[4][MOST + 1][16] __attribute__((aligned(64))), M[MOST][16];
      memset(M4, 0, sizeof M4);
      float cx[BLOCK] __attribute__((aligned(64))), cy[BLOCK] __attribute__((aligned(64))),
          cz[BLOCK] __attribute__((aligned(64)));
      int who[BLOCK] __attribute__((aligned(64)));
      for (int from = 0; from < n; from += BLOCK) {
        int m = n - from < BLOCK ? n - from : BLOCK;
        assign(limbs, count, x + from, y + from, z + from, m, reach * reach, cx, cy, cz, who);
        for (int i = 0; i < m; i++) {
          float *sum = M4[i & 3][who[i]], c[4] = {1, cx[i], cy[i], cz[i]};
          float p[4] = {1, x[from + i], y[from + i], z[from + i]};
          for (int a = 0; a < 16; a++) sum[a] += c[a / 4] * p[a % 4];
        }
      }
      memset(M, 0, sizeof M);
      for (int l = 0; l < count; l++)
        for (int a = 0; a < 16; a++) M[l][a] = M4[0][l][a] + M4[1][l][a] + M4[2][l][a] + M4[3][l][a];
      band_moments(M, R, t, joints, parent, child, pa, pc, weight, ratio, least);
      for (int l = 0; l < count; l++) horn(M[l], R + 9 * l, t + 3 * l);
    }
}
