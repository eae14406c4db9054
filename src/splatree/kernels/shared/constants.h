// The numbers of splatree/constants.py, which has their units and sources. Written by scripts/constants; do not edit.
#pragma once

namespace splatree::constants {

constexpr double ALPHA_THRESHOLD = 0.00392156862745098;
constexpr double LOG2_ALPHA_THRESHOLD = -7.994353436858858;
constexpr double ALPHA_MAX = 0.99;
constexpr double TRANSMITTANCE_MIN = 0.0001;
constexpr double DILATION_PX2 = 0.3;
constexpr int SSIM_WINDOW_PX = 11;
constexpr double SSIM_SIGMA_PX = 1.5;
constexpr double SSIM_K1 = 0.01;
constexpr double SSIM_K2 = 0.03;
constexpr double NEAR = 0.2;
constexpr int TILE_PX = 16;
constexpr double FRUSTUM_CLAMP = 1.3;
constexpr double DILATION_MIN_PX2 = 1e-06;
constexpr double SIGMA_MAX_PX = 500000000.0;
constexpr double SIGMAS = 3.0;
constexpr double TAPER_SLOPE = 2.0;
constexpr double SHRINK_AREA_POWER = 0.4;
constexpr double SHRINK_AREA_PX2 = 0.3;
constexpr double LOG2_SHRINK_AREA_PX2 = -1.7369655941662063;
constexpr double SHRINK_ENERGY_MIN = 0.01;
constexpr double SHRINK_RATIO_MIN = 0.1;
constexpr double SHRINK_PAD_PX = 1.0;
constexpr double PIXEL_ERROR = 3.0;
constexpr double DILATION_MAX_PX2 = 1000000000000.0;
constexpr double EIGENVALUE_FLOOR_PX4 = 0.1;
constexpr double CENTRE_PAD = 0.1;
constexpr int BLOCK_ROWS = 256;
constexpr int BLOCK_STEPS = 8;
constexpr int BLOCKS_PER_GROUP = 64;
constexpr double SH_C0 = 0.28209479177387814;
constexpr double SH_C1 = 0.4886025119029199;
constexpr double SH_C2_0 = 1.0925484305920792;
constexpr double SH_C2_1 = -1.0925484305920792;
constexpr double SH_C2_2 = 0.31539156525252005;
constexpr double SH_C2_3 = -1.0925484305920792;
constexpr double SH_C2_4 = 0.5462742152960396;
constexpr double SH_C3_0 = -0.5900435899266435;
constexpr double SH_C3_1 = 2.890611442640554;
constexpr double SH_C3_2 = -0.4570457994644658;
constexpr double SH_C3_3 = 0.3731763325901154;
constexpr double SH_C3_4 = -0.4570457994644658;
constexpr double SH_C3_5 = 1.445305721320277;
constexpr double SH_C3_6 = -0.5900435899266435;
constexpr int SH_MAX_DEGREE = 3;
constexpr double MERGED_ALPHA_MAX = 0.999;
constexpr double MERGED_LOG_SCALE_MAX = 80.0;

}  // namespace splatree::constants
