#include "cpu/codec/columns.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <vector>

#include "cpu/runtime/files.h"
#include "cpu/runtime/isa.h"
#include "cpu/runtime/pool.h"
#include "cpu/runtime/quad.h"

namespace splatree {
namespace {

constexpr int64_t BYTES_PER_CHUNK = 1 << 17;   // records in and as many floats out fit a second-level cache of 512 B
constexpr int64_t VALUES_PER_CHUNK = 1 << 18;  // 1 MB

void raise(std::atomic<int32_t>& largest, int32_t found) {
  int32_t seen = largest.load(std::memory_order_relaxed);
  while (found > seen && !largest.compare_exchange_weak(seen, found, std::memory_order_relaxed)) {
  }
}

float magnitude(int32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

template <class T>
T load(const uint8_t* at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  return value;
}

float load_as_float(const uint8_t* at, Scalar type) {
  switch (type) {
    case Scalar::i8:
      return load<int8_t>(at);
    case Scalar::u8:
      return load<uint8_t>(at);
    case Scalar::i16:
      return load<int16_t>(at);
    case Scalar::u16:
      return load<uint16_t>(at);
    case Scalar::i32:
      return static_cast<float>(load<int32_t>(at));
    case Scalar::u32:
      return static_cast<float>(load<uint32_t>(at));
    case Scalar::f32:
      return load<float>(at);
    case Scalar::f64:
      return static_cast<float>(load<double>(at));
  }
  return 0;
}

// How the values of a row of a column lie in the record.
enum class Layout {
  run,       // side by side
  channels,  // three side by side, then the rest channel by channel: the harmonics of a .ply
  scattered  // anything else
};

Layout layout_of(const Column& column) {
  const int64_t width = column.width, *offsets = column.offsets;
  for (int64_t j = 0; j < width; ++j)
    if (column.types[j] != Scalar::f32) return Layout::scattered;
  const auto follows = [&](int64_t j, int64_t start, int64_t place) { return offsets[j] == start + 4 * place; };
  int64_t run = 0;
  while (run < width && follows(run, offsets[0], run)) ++run;
  if (run == width) return Layout::run;
  if (run < 3 || width % 3) return Layout::scattered;
  const int64_t per_channel = width / 3 - 1;
  for (int64_t j = 3; j < width; ++j)
    if (!follows(j, offsets[3], (j % 3) * per_channel + j / 3 - 1)) return Layout::scattered;
  return Layout::channels;
}

template <int WIDTH>
void copy_runs(const uint8_t* from, int64_t stride, float* out, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row) std::memcpy(out + row * WIDTH, from + row * stride, WIDTH * 4);
}

Quad load_loose(const void* from) { return load<Quad>(static_cast<const uint8_t*>(from)); }
void store_loose(void* to, Quad quad) { std::memcpy(to, &quad, sizeof quad); }

// Harmonics four at a time; the last four overlap those before where their number is no multiple of four. The three of degree 1
// go one by one.
template <int PER_CHANNEL>
void copy_channels(const uint8_t* first, const uint8_t* rest, int64_t stride, float* out, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row, first += stride, rest += stride, out += 3 * (PER_CHANNEL + 1)) {
    std::memcpy(out, first, 12);
    for (int j = 0; PER_CHANNEL < 4 && j < PER_CHANNEL; ++j)
      for (int c = 0; c < 3; ++c) out[3 + 3 * j + c] = load<float>(rest + 4 * (c * PER_CHANNEL + j));
    for (int next = 0; PER_CHANNEL >= 4 && next < PER_CHANNEL; next += 4) {
      const int j = std::min(next, PER_CHANNEL - 4);
      const uint8_t* at = rest + 4 * j;
      Quad r = load_loose(at), g = load_loose(at + 4 * PER_CHANNEL), b = load_loose(at + 8 * PER_CHANNEL);
      interleave_triples(r, g, b);
      float* triples = out + 3 + 3 * j;
      store_loose(triples, r), store_loose(triples + 4, g), store_loose(triples + 8, b);
    }
  }
}

void copy_scattered(const uint8_t* record, int64_t stride, const Column& column, float* out, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row, record += stride)
    for (int64_t j = 0; j < column.width; ++j) *out++ = load_as_float(record + column.offsets[j], column.types[j]);
}

void copy_column(const uint8_t* records, int64_t stride, const Column& column, Layout layout, float* out, int64_t num_rows) {
  const uint8_t* from = records + column.offsets[0];
  if (layout == Layout::run) switch (column.width) {
      case 1:
        return copy_runs<1>(from, stride, out, num_rows);
      case 3:
        return copy_runs<3>(from, stride, out, num_rows);
      case 4:
        return copy_runs<4>(from, stride, out, num_rows);
    }
  if (layout == Layout::channels) {
    const uint8_t* rest = records + column.offsets[3];
    switch (column.width) {
      case 12:
        return copy_channels<3>(from, rest, stride, out, num_rows);
      case 27:
        return copy_channels<8>(from, rest, stride, out, num_rows);
      case 48:
        return copy_channels<15>(from, rest, stride, out, num_rows);
    }
  }
  copy_scattered(records, stride, column, out, num_rows);
}

template <int WIDTH>
void place_runs(const float* from, uint8_t* out, int64_t stride, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row) std::memcpy(out + row * stride, from + row * WIDTH, WIDTH * 4);
}

template <int PER_CHANNEL>
void place_channels(const float* from, uint8_t* first, uint8_t* rest, int64_t stride, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row, first += stride, rest += stride, from += 3 * (PER_CHANNEL + 1)) {
    std::memcpy(first, from, 12);
    for (int j = 0; PER_CHANNEL < 4 && j < PER_CHANNEL; ++j)
      for (int c = 0; c < 3; ++c) std::memcpy(rest + 4 * (c * PER_CHANNEL + j), from + 3 + 3 * j + c, 4);
    for (int next = 0; PER_CHANNEL >= 4 && next < PER_CHANNEL; next += 4) {
      const int j = std::min(next, PER_CHANNEL - 4);
      const float* triples = from + 3 + 3 * j;
      Quad r = load_loose(triples), g = load_loose(triples + 4), b = load_loose(triples + 8);
      transpose_triples(r, g, b);
      uint8_t* at = rest + 4 * j;
      store_loose(at, r), store_loose(at + 4 * PER_CHANNEL, g), store_loose(at + 8 * PER_CHANNEL, b);
    }
  }
}

void place_scattered(const float* from, uint8_t* record, int64_t stride, const Column& column, int64_t num_rows) {
  for (int64_t row = 0; row < num_rows; ++row, record += stride)
    for (int64_t j = 0; j < column.width; ++j) std::memcpy(record + column.offsets[j], from++, 4);
}

void place_column(const float* from, const Column& column, Layout layout, uint8_t* records, int64_t stride, int64_t num_rows) {
  uint8_t* first = records + column.offsets[0];
  if (layout == Layout::run) switch (column.width) {
      case 1:
        return place_runs<1>(from, first, stride, num_rows);
      case 3:
        return place_runs<3>(from, first, stride, num_rows);
      case 4:
        return place_runs<4>(from, first, stride, num_rows);
    }
  if (layout == Layout::channels) {
    uint8_t* rest = records + column.offsets[3];
    switch (column.width) {
      case 12:
        return place_channels<3>(from, first, rest, stride, num_rows);
      case 27:
        return place_channels<8>(from, first, rest, stride, num_rows);
      case 48:
        return place_channels<15>(from, first, rest, stride, num_rows);
    }
  }
  place_scattered(from, records, stride, column, num_rows);
}

// Bytes of a file in a buffer of this thread, valid until its next call.
const uint8_t* read_bytes(int file, int64_t at, int64_t num_bytes) {
  thread_local std::vector<uint8_t> buffer;
  if (static_cast<int64_t>(buffer.size()) < num_bytes) buffer.resize(num_bytes);
  read_at(file, buffer.data(), num_bytes, at);
  return buffer.data();
}

}  // namespace

void deinterleave(int file, int64_t start, int64_t num_rows, int64_t stride, Column* columns, int num_columns, int threads) {
  Layout layouts[MAX_COLUMNS];
  std::atomic<int32_t> largest[MAX_COLUMNS];
  for (int c = 0; c < num_columns; ++c) {
    layouts[c] = layout_of(columns[c]);
    largest[c] = 0;
  }
  const int64_t rows_per_chunk = std::max<int64_t>(1, BYTES_PER_CHUNK / stride);
  parallel_ranges(num_rows, rows_per_chunk, threads, [&](int64_t begin, int64_t end) {
    const uint8_t* records = read_bytes(file, start + begin * stride, (end - begin) * stride);
    for (int c = 0; c < num_columns; ++c) {
      const int64_t width = columns[c].width;
      float* out = columns[c].data + begin * width;
      copy_column(records, stride, columns[c], layouts[c], out, end - begin);
      raise(largest[c], kernels().largest_bits(out, (end - begin) * width));
    }
  });
  for (int c = 0; c < num_columns; ++c) columns[c].largest_magnitude = magnitude(largest[c].load());
}

void interleave(const Column* columns, int num_columns, int64_t num_rows, int64_t stride, uint8_t* records, int threads) {
  Layout layouts[MAX_COLUMNS];
  for (int c = 0; c < num_columns; ++c) layouts[c] = layout_of(columns[c]);
  const int64_t rows_per_chunk = std::max<int64_t>(1, BYTES_PER_CHUNK / stride);
  parallel_ranges(num_rows, rows_per_chunk, threads, [&](int64_t begin, int64_t end) {
    for (int c = 0; c < num_columns; ++c)
      place_column(columns[c].data + begin * columns[c].width, columns[c], layouts[c], records + begin * stride, stride,
                   end - begin);
  });
}

float largest_magnitude(const float* values, int64_t num_values, int threads) {
  std::atomic<int32_t> largest{0};
  parallel_ranges(num_values, VALUES_PER_CHUNK, threads,
                  [&](int64_t begin, int64_t end) { raise(largest, kernels().largest_bits(values + begin, end - begin)); });
  return magnitude(largest.load());
}

float shortest(const float* vectors, int64_t num_vectors, int threads) {
  std::atomic<float> shortest{INFINITY};
  parallel_ranges(num_vectors, VALUES_PER_CHUNK / 4, threads, [&](int64_t begin, int64_t end) {
    float found = INFINITY;
    for (int64_t i = begin; i < end; ++i) {
      const float* v = vectors + 4 * i;
      const float squared = (v[0] * v[0] + v[1] * v[1]) + (v[2] * v[2] + v[3] * v[3]);
      found = squared < found ? squared : found;
    }
    float seen = shortest.load(std::memory_order_relaxed);
    while (found < seen && !shortest.compare_exchange_weak(seen, found, std::memory_order_relaxed)) {
    }
  });
  return std::sqrt(shortest.load());
}

}  // namespace splatree
