// Rotations and covariances of single Gaussians, for sources that are not vectorised.
#pragma once

namespace splatree {

// Row by row, of a quaternion wxyz of any length; of a zero one the identity.
template <class Real>
void rotation_from_quat(const float* quat, Real* R) {
  const Real w = quat[0], x = quat[1], y = quat[2], z = quat[3];
  const Real norm2 = w * w + x * x + y * y + z * z;
  const Real s = norm2 > 0 ? 2 / norm2 : 0;
  R[0] = 1 - s * (y * y + z * z), R[1] = s * (x * y - w * z), R[2] = s * (x * z + w * y);
  R[3] = s * (x * y + w * z), R[4] = 1 - s * (x * x + z * z), R[5] = s * (y * z - w * x);
  R[6] = s * (x * z - w * y), R[7] = s * (y * z + w * x), R[8] = 1 - s * (x * x + y * y);
}

// Σ = R diag(variance) Rᵀ as xx xy xz yy yz zz.
template <class Real>
void covariance_from(const float* quat, const Real* variance, Real* covariance) {
  Real R[9];
  rotation_from_quat(quat, R);
  for (int i = 0, k = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++k)
      covariance[k] = R[3 * i] * R[3 * j] * variance[0] + R[3 * i + 1] * R[3 * j + 1] * variance[1] +
                      R[3 * i + 2] * R[3 * j + 2] * variance[2];
}

}  // namespace splatree
