// Bytes at places of an open file, all of them: the system may take or give a part at a time.
#pragma once
#include <cstdint>

namespace splatree {

// Throws std::system_error, or std::runtime_error if the file ends before.
void read_at(int file, void* data, int64_t num_bytes, int64_t at);

// Throws std::system_error.
void write_at(int file, const void* data, int64_t num_bytes, int64_t at);

// Sets room aside for a file that is about to be written: a full disk is told before the work, and pages that have their place
// on the disk cost a third less to write. Does nothing where the file system has no such call. Throws std::system_error.
void reserve(int file, int64_t num_bytes);

}  // namespace splatree
