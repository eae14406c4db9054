// What backward stages and the loss add up, and in which order the sums lie.
#pragma once

namespace splatree {

// Over the pixels of a pair, and then over the pairs of a splat.
enum SplatSum {
  SUM_H,
  SUM_HU,
  SUM_HV,
  SUM_HUU,
  SUM_HUV,
  SUM_HVV,
  SUM_RED,
  SUM_GREEN,
  SUM_BLUE,
  SUM_DEPTH,
  SUM_WEIGHT,
  SUM_ERROR,
  NUM_SUMS,
};

// Over the pixels of a picture that is compared with a photograph.
enum LossSum { SUM_DIFFERENCE, SUM_INDEX, SUM_PRODUCT, SUM_SQUARE = SUM_PRODUCT + 3, NUM_LOSS_SUMS = SUM_SQUARE + 3 };

}  // namespace splatree
