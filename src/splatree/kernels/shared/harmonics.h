// Real spherical harmonics; maths/harmonics.py is the definition.
#pragma once
#include "shared/constants.h"
#include "shared/portable.h"

namespace splatree {
namespace {

// Y_k of the unit direction (x, y, z), k < (degree + 1)^2, at basis[k * stride].
SPLATREE_FN void harmonics_of(float x, float y, float z, int degree, float* basis, int stride) {
  basis[0] = 0.28209479f;  // one unit in the last place below constants::SH_C0: pictures keep the bits that they have
  if (degree < 1) return;
  basis[1 * stride] = -float(constants::SH_C1) * y;
  basis[2 * stride] = float(constants::SH_C1) * z;
  basis[3 * stride] = -float(constants::SH_C1) * x;
  if (degree < 2) return;
  const float xx = x * x, yy = y * y, zz = z * z;
  basis[4 * stride] = float(constants::SH_C2_0) * (x * y);
  basis[5 * stride] = float(constants::SH_C2_1) * (y * z);
  basis[6 * stride] = float(constants::SH_C2_2) * (2.f * zz - xx - yy);
  basis[7 * stride] = float(constants::SH_C2_3) * (x * z);
  basis[8 * stride] = float(constants::SH_C2_4) * (xx - yy);
  if (degree < 3) return;
  basis[9 * stride] = float(constants::SH_C3_0) * (y * (3.f * xx - yy));
  basis[10 * stride] = float(constants::SH_C3_1) * (x * y * z);
  basis[11 * stride] = float(constants::SH_C3_2) * (y * (4.f * zz - xx - yy));
  basis[12 * stride] = float(constants::SH_C3_3) * (z * (2.f * zz - 3.f * xx - 3.f * yy));
  basis[13 * stride] = float(constants::SH_C3_4) * (x * (4.f * zz - xx - yy));
  basis[14 * stride] = float(constants::SH_C3_5) * (z * (xx - yy));
  basis[15 * stride] = float(constants::SH_C3_6) * (x * (xx - 3.f * yy));
}

}  // namespace
}  // namespace splatree
