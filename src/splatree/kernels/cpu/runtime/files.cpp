#include "cpu/runtime/files.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>
#include <system_error>

namespace splatree {
namespace {

[[noreturn]] void fail() { throw std::system_error(errno, std::generic_category()); }

}  // namespace

void read_at(int file, void* data, int64_t num_bytes, int64_t at) {
  for (char* to = static_cast<char*>(data); num_bytes > 0;) {
    const ssize_t got = pread(file, to, num_bytes, at);
    if (got == 0) throw std::runtime_error("the file ends before its last record");
    if (got < 0 && errno != EINTR) fail();
    if (got > 0) to += got, at += got, num_bytes -= got;
  }
}

void write_at(int file, const void* data, int64_t num_bytes, int64_t at) {
  for (const char* from = static_cast<const char*>(data); num_bytes > 0;) {
    const ssize_t put = pwrite(file, from, num_bytes, at);
    if (put < 0 && errno != EINTR) fail();
    if (put > 0) from += put, at += put, num_bytes -= put;
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
