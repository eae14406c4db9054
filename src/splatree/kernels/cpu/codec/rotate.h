// Harmonics of a turned scene.
#pragma once
#include <cstdint>

namespace splatree {

// out[row][k][c] = Σ_j matrices[k][j] in[row][j][c] within each degree 1 … `degree`; the DC is copied. `matrices` holds the
// (2l + 1)² entries of degree 1, then of 2, then of 3, row by row; in and out hold num_rows × (degree + 1)² × 3.
void rotate_harmonics(const float* in, int64_t num_rows, int degree, const float* matrices, float* out, int threads);

}  // namespace splatree
