// A flag for each row of a block, a bit each: what is set is found and ranges are cleared 64 rows at a time. For select.cpp
// alone, which is compiled for each instruction set.
#pragma once
#include "cpu/frame/select.h"
#include "cpu/runtime/isa.h"

namespace splatree::SPLATREE_ISA {
namespace {

// For each byte of eight flags, the places of those that are set.
struct PlacesOfByte {
  uint8_t place[256][8] = {};

  constexpr PlacesOfByte() {
    for (int byte = 0; byte < 256; ++byte)
      for (int bit = 0, size = 0; bit < 8; ++bit)
        if (byte >> bit & 1) place[byte][size++] = uint8_t(bit);
  }
};

constexpr PlacesOfByte PLACES;

class Flags {
 public:
  static constexpr int WORD = 64;

  // Those i < count for which is_set(i).
  template <class IsSet>
  Flags(int count, const IsSet& is_set) : count_(count) {
    alignas(64) uint8_t bytes[MAX_BLOCK_ROWS + WORD];
    for (int i = 0; i < count; ++i) bytes[i] = is_set(i);
    for (int i = count; i < count + WORD; ++i) bytes[i] = 0;
    for (int begin = 0; begin < count; begin += WORD) {
      uint64_t word = 0;
      for (int i = 0; i < WORD; i += 8) {
        uint64_t eight;
        __builtin_memcpy(&eight, bytes + begin + i, 8);
        word |= (eight * 0x0102040810204080u >> 56) << i;  // gathers the lowest bits of the eight bytes
      }
      words_[begin / WORD] = word;
    }
  }

  // The first one that is set at or behind a place; the count if there is none.
  int next(int64_t from) const {
    if (from >= count_) return count_;
    int word = int(from / WORD);
    uint64_t left = words_[word] & ~uint64_t(0) << from % WORD;
    while (!left) {
      if (++word * WORD >= count_) return count_;
      left = words_[word];
    }
    return word * WORD + __builtin_ctzll(left);
  }

  void set(int64_t place) { words_[place / WORD] |= uint64_t(1) << place % WORD; }

  void clear(int64_t first, int64_t end) {
    while (first < end) {
      const int64_t word = first / WORD, stop = end < (word + 1) * WORD ? end : (word + 1) * WORD;
      words_[word] &= ~(~uint64_t(0) >> (WORD - (stop - first)) << first % WORD);
      first = stop;
    }
  }

  void keep(const Flags& other) {
    for (int word = 0; word * WORD < count_; ++word) words_[word] &= other.words_[word];
  }

  // first + i for each i that is set; out has room for 8 more.
  int list(int32_t first, int32_t* out) const {
    int size = 0;
    for (int begin = 0; begin < count_; begin += WORD) {
      for (uint64_t word = words_[begin / WORD], i = 0; word; word >>= 8, i += 8) {
        const unsigned byte = unsigned(word & 255);
        for (int l = 0; l < 8; ++l) out[size + l] = first + begin + int32_t(i) + PLACES.place[byte][l];
        size += __builtin_popcount(byte);
      }
    }
    return size;
  }

 private:
  uint64_t words_[MAX_BLOCK_ROWS / WORD];
  int count_;
};

}  // namespace
}  // namespace splatree::SPLATREE_ISA
