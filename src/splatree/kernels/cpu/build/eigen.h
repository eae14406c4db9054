// Axes of symmetric 3×3 matrices, for sources that are not vectorised.
#pragma once
#include <algorithm>
#include <cmath>

namespace splatree {

// Shepperd's method: the largest of the four squares is divided by, so no cancellation. w ≥ 0.
inline void quat_from_rotation(const double* R, float* quat) {
  const double trace = R[0] + R[4] + R[8];
  double q[4];
  if (trace > 0) {
    const double s = 2 * std::sqrt(1 + trace);
    q[0] = s / 4, q[1] = (R[7] - R[5]) / s, q[2] = (R[2] - R[6]) / s, q[3] = (R[3] - R[1]) / s;
  } else if (R[0] >= R[4] && R[0] >= R[8]) {
    const double s = 2 * std::sqrt(std::max(1 + R[0] - R[4] - R[8], 0.0));
    q[0] = (R[7] - R[5]) / s, q[1] = s / 4, q[2] = (R[1] + R[3]) / s, q[3] = (R[2] + R[6]) / s;
  } else if (R[4] >= R[8]) {
    const double s = 2 * std::sqrt(std::max(1 + R[4] - R[0] - R[8], 0.0));
    q[0] = (R[2] - R[6]) / s, q[1] = (R[1] + R[3]) / s, q[2] = s / 4, q[3] = (R[5] + R[7]) / s;
  } else {
    const double s = 2 * std::sqrt(std::max(1 + R[8] - R[0] - R[4], 0.0));
    q[0] = (R[3] - R[1]) / s, q[1] = (R[2] + R[6]) / s, q[2] = (R[5] + R[7]) / s, q[3] = s / 4;
  }
  const double sign = q[0] < 0 ? -1 : 1;
  for (int i = 0; i < 4; ++i) quat[i] = static_cast<float>(sign * q[i]);
}

// Eigenvalues, largest first, and eigenvectors (columns of a proper rotation V) of a symmetric 3×3 matrix: cyclic Jacobi. It
// ends when each element off the diagonal is below 1e-10 of its two on it (Demmel and Veselić 1992): what is left changes an
// eigenvalue by 1e-20 of itself, small ones too.
inline void eigen_symmetric(double A[3][3], double* values, double* R) {
  double V[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int sweep = 0; sweep < 16; ++sweep) {
    bool rotated = false;
    for (int p = 0; p < 2; ++p)
      for (int q = p + 1; q < 3; ++q) {
        if (A[p][q] * A[p][q] <= 1e-20 * std::abs(A[p][p] * A[q][q])) continue;
        rotated = true;
        const double theta = (A[q][q] - A[p][p]) / (2 * A[p][q]);
        const double t = (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        const double apq = A[p][q];
        A[p][p] -= t * apq;
        A[q][q] += t * apq;
        A[p][q] = A[q][p] = 0;
        const int r = 3 - p - q;
        const double arp = A[r][p], arq = A[r][q];
        A[r][p] = A[p][r] = c * arp - s * arq;
        A[r][q] = A[q][r] = s * arp + c * arq;
        for (int i = 0; i < 3; ++i) {
          const double vip = V[i][p], viq = V[i][q];
          V[i][p] = c * vip - s * viq;
          V[i][q] = s * vip + c * viq;
        }
      }
    if (!rotated) break;
  }
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int a, int b) { return A[a][a] > A[b][b]; });
  for (int a = 0; a < 3; ++a) {
    values[a] = A[order[a]][order[a]];
    for (int i = 0; i < 3; ++i) R[3 * i + a] = V[i][order[a]];
  }
  const double determinant =
      R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]);
  if (determinant < 0)
    for (int i = 0; i < 3; ++i) R[3 * i + 2] = -R[3 * i + 2];
}

}  // namespace splatree
