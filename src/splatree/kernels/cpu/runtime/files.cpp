#include "cpu/runtime/files.h"

#include <cerrno>
#include <stdexcept>
#include <system_error>

#ifdef _WIN32
#ifndef NOMINMAX
#define NOMINMAX
#endif
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
// After windows.h, which declares what it needs.
#include <io.h>
#else
#include <fcntl.h>
#include <unistd.h>
#endif

namespace splatree {
namespace {

#ifdef _WIN32

// A read or write at a place, as pread and pwrite are elsewhere: the number of bytes moved. At most 1 GB at a time, since
// Windows counts bytes in 32 bits.
template <class Move, class Data>
int64_t move_at(Move move, int file, Data* data, int64_t num_bytes, int64_t at) {
  OVERLAPPED place{};
  place.Offset = static_cast<DWORD>(at);
  place.OffsetHigh = static_cast<DWORD>(at >> 32);
  DWORD moved = 0;
  const DWORD most = num_bytes < (1 << 30) ? static_cast<DWORD>(num_bytes) : 1 << 30;
  if (!move(reinterpret_cast<HANDLE>(_get_osfhandle(file)), data, most, &moved, &place)) {
    const DWORD code = GetLastError();
    if (code == ERROR_HANDLE_EOF) return 0;
    throw std::system_error(static_cast<int>(code), std::system_category());
  }
  return moved;
}

int64_t read_some(int file, void* data, int64_t num_bytes, int64_t at) { return move_at(ReadFile, file, data, num_bytes, at); }
int64_t write_some(int file, const void* data, int64_t num_bytes, int64_t at) {
  return move_at(WriteFile, file, data, num_bytes, at);
}

#else

[[noreturn]] void fail() { throw std::system_error(errno, std::generic_category()); }

int64_t read_some(int file, void* data, int64_t num_bytes, int64_t at) {
  for (;;) {
    const int64_t got = pread(file, data, static_cast<size_t>(num_bytes), at);
    if (got >= 0) return got;
    if (errno != EINTR) fail();
  }
}

int64_t write_some(int file, const void* data, int64_t num_bytes, int64_t at) {
  for (;;) {
    const int64_t put = pwrite(file, data, static_cast<size_t>(num_bytes), at);
    if (put >= 0) return put;
    if (errno != EINTR) fail();
  }
}

#endif

}  // namespace

void read_at(int file, void* data, int64_t num_bytes, int64_t at) {
  for (char* to = static_cast<char*>(data); num_bytes > 0;) {
    const int64_t got = read_some(file, to, num_bytes, at);
    if (got == 0) throw std::runtime_error("the file ends before its last record");
    to += got, at += got, num_bytes -= got;
  }
}

void write_at(int file, const void* data, int64_t num_bytes, int64_t at) {
  for (const char* from = static_cast<const char*>(data); num_bytes > 0;) {
    const int64_t put = write_some(file, from, num_bytes, at);
    from += put, at += put, num_bytes -= put;
  }
}

void reserve(int file, int64_t num_bytes) {
#ifdef __linux__
  // Not posix_fallocate: where the file system cannot, it would write to every page.
  while (num_bytes > 0 && fallocate(file, 0, 0, num_bytes) != 0) {
    if (errno == EOPNOTSUPP || errno == ENOSYS) return;
    if (errno != EINTR) fail();
  }
#else
  (void)file, (void)num_bytes;
#endif
}

}  // namespace splatree
