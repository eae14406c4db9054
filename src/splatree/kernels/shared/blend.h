// What variants of the blend there are, as policies: a kernel is compiled once for each pair of them.
#pragma once

namespace splatree {

// How a splat ends: at its threshold, or tapered off towards its floor.
struct Hard {
  static constexpr bool TAPERS = false;
};
struct Taper {
  static constexpr bool TAPERS = true;
};

// What is kept beside colour and alpha: nothing; the depth; and something of each pixel, the contribution of each pair, or both.
struct ColorsAlone {
  static constexpr bool OF_DEPTH = false, OF_PIXELS = false, OF_PAIRS = false;
};
struct PictureAlone {
  static constexpr bool OF_DEPTH = true, OF_PIXELS = false, OF_PAIRS = false;
};
struct AndPixels {
  static constexpr bool OF_DEPTH = true, OF_PIXELS = true, OF_PAIRS = false;
};
struct AndPairs {
  static constexpr bool OF_DEPTH = true, OF_PIXELS = false, OF_PAIRS = true;
};
struct AndBoth {
  static constexpr bool OF_DEPTH = true, OF_PIXELS = true, OF_PAIRS = true;
};

// The transmittance below which more than half of the light is stopped: `median_depth` is that of the splat that passes it.
constexpr float HALF_TRANSMITTANCE = 0.5f;

}  // namespace splatree
