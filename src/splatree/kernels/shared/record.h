// A splat as one record of 16 floats: the columns of Splats.records (scene/frame.py).
#pragma once

namespace splatree {

enum Column {
  X,
  Y,  // centre, px
  FACTOR_A,
  FACTOR_B,
  FACTOR_C,  // L = ((a, b), (0, c)); LᵀL is the conic, px^-2
  OPACITY,
  LOG2_OPACITY,
  RED,
  GREEN,
  BLUE,
  DEPTH,
  HALF_SIZE_X,
  HALF_SIZE_Y,  // half size of the box, px
  NUM_COLUMNS = 16,
};

}  // namespace splatree
