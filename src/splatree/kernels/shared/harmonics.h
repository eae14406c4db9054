// Real spherical harmonics; maths/harmonics.py is the definition.
#pragma once
#include "shared/portable.h"

namespace splatree {
namespace {

// Y_k of the unit direction (x, y, z), k < (degree + 1)^2, at basis[k * stride].
SPLATREE_FN void harmonics_of(float x, float y, float z, int degree, float* basis, int stride) {
  basis[0] = 0.28209479f;
  if (degree < 1) return;
  basis[1 * stride] = -0.48860251f * y;
  basis[2 * stride] = 0.48860251f * z;
  basis[3 * stride] = -0.48860251f * x;
  if (degree < 2) return;
  const float xx = x * x, yy = y * y, zz = z * z;
  basis[4 * stride] = 1.09254843f * (x * y);
  basis[5 * stride] = -1.09254843f * (y * z);
  basis[6 * stride] = 0.31539157f * (2.f * zz - xx - yy);
  basis[7 * stride] = -1.09254843f * (x * z);
  basis[8 * stride] = 0.54627422f * (xx - yy);
  if (degree < 3) return;
  basis[9 * stride] = -0.59004359f * (y * (3.f * xx - yy));
  basis[10 * stride] = 2.89061144f * (x * y * z);
  basis[11 * stride] = -0.45704580f * (y * (4.f * zz - xx - yy));
  basis[12 * stride] = 0.37317633f * (z * (2.f * zz - 3.f * xx - 3.f * yy));
  basis[13 * stride] = -0.45704580f * (x * (4.f * zz - xx - yy));
  basis[14 * stride] = 1.44530572f * (z * (xx - yy));
  basis[15 * stride] = -0.59004359f * (x * (xx - 3.f * yy));
}

}  // namespace
}  // namespace splatree
