// The functions of the CUDA driver that the runtime calls (kernels/cuda/driver.h, against which this is compiled), played on a
// processor: memory is the process's own, a module names kernels that are linked into this library.
//
// As lazy as a device can be: nothing runs before the host waits, and then only the stream that it waits for, with what that one
// waits for itself. So a host that overwrites what is still to be copied, reads what has not arrived, or leaves the order of two
// streams to chance, gets what it deserves. As strict as the driver: calls need cuInit, a current context in their thread,
// handles that exist, events that were recorded, and nothing that a recording forbids. And stricter, by ending the launch with a
// message, where a device would go on with wrong results: what touches memory that was freed, is launched with other threads than
// its kernel is built for, writes around its array, or is recorded from memory that is not pinned.
//
// Waits of the host are counted: those asked for, and those that come with freeing memory or copying from memory that is not
// pinned.
#include "cuda/driver.h"

#include <dlfcn.h>
#include <elf.h>

#include <chrono>
#include <cstdlib>
#include <deque>
#include <memory>
#include <mutex>
#include <set>
#include <thread>

#include "simt.h"

#define API extern "C" __attribute__((visibility("default")))

namespace {

using simt::failure;
using Work = std::function<void()>;

// Errors of cuda.h that driver.h has no need of.
constexpr int INVALID_VALUE = CUDA_ERROR_INVALID_VALUE, NOT_INITIALIZED = 3, INVALID_DEVICE = 101, INVALID_IMAGE = 200,
              INVALID_CONTEXT = 201, INVALID_HANDLE = 400, NOT_FOUND = 500, LAUNCH_FAILED = 719, CAPTURE_UNSUPPORTED = 900,
              CAPTURE_INVALIDATED = 901;
const std::map<int, const char*> ERROR_NAMES = {
    {INVALID_VALUE, "CUDA_ERROR_INVALID_VALUE"},
    {CUDA_ERROR_OUT_OF_MEMORY, "CUDA_ERROR_OUT_OF_MEMORY"},
    {NOT_INITIALIZED, "CUDA_ERROR_NOT_INITIALIZED"},
    {CUDA_ERROR_STUB_LIBRARY, "CUDA_ERROR_STUB_LIBRARY"},
    {CUDA_ERROR_NO_DEVICE, "CUDA_ERROR_NO_DEVICE"},
    {INVALID_DEVICE, "CUDA_ERROR_INVALID_DEVICE"},
    {INVALID_IMAGE, "CUDA_ERROR_INVALID_IMAGE"},
    {INVALID_CONTEXT, "CUDA_ERROR_INVALID_CONTEXT"},
    {INVALID_HANDLE, "CUDA_ERROR_INVALID_HANDLE"},
    {NOT_FOUND, "CUDA_ERROR_NOT_FOUND"},
    {CUDA_ERROR_NOT_READY, "CUDA_ERROR_NOT_READY"},
    {LAUNCH_FAILED, "CUDA_ERROR_LAUNCH_FAILED"},
    {CUDA_ERROR_SYSTEM_DRIVER_MISMATCH, "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH"},
    {CAPTURE_UNSUPPORTED, "CUDA_ERROR_STREAM_CAPTURE_UNSUPPORTED"},
    {CAPTURE_INVALIDATED, "CUDA_ERROR_STREAM_CAPTURE_INVALIDATED"},
};

constexpr size_t GUARD = 256;  // bytes around an array
constexpr char GUARD_BYTE = '\xdb', FRESH_BYTE = '\xa5';

struct Machine {
  int version = 13000, num_devices = 1, major = 9, minor = 0, init = CUDA_SUCCESS;
} machine;
bool initialized = false;
thread_local CUcontext current_context = nullptr;

}  // namespace

struct CUctx_st {};
struct CUmod_st {
  std::map<std::string, unsigned> threads_of;  // by name of the kernel; 0: not known
};
struct CUfunc_st {
  std::string name;
  simt::Kernel kernel;
  unsigned threads;
};
struct CUgraph_st {
  std::vector<Work> work;
};
struct CUgraphExec_st {
  std::vector<Work> work;
};
struct CUstream_st {
  std::deque<Work> queue;
  long long num_enqueued = 0, num_done = 0;
  CUgraph_st* recording = nullptr;
  bool spoiled = false;  // the recording
};
struct CUevent_st {
  CUstream_st* stream = nullptr;  // where it was recorded; null: nowhere
  long long ticket = 0;           // work of that stream that lies before it
  bool timed = true;
  double seconds = -1;
};

namespace {

// Handles that the host holds.
template <class T>
class Handles {
 public:
  T* add() { return all_.emplace(std::make_unique<T>()).first->get(); }
  bool has(const T* handle) const {
    for (const auto& known : all_)
      if (known.get() == handle) return true;
    return false;
  }
  bool drop(const T* handle) {
    for (auto known = all_.begin(); known != all_.end(); ++known)
      if (known->get() == handle) return all_.erase(known), true;
    return false;
  }
  const std::set<std::unique_ptr<T>>& all() const { return all_; }

 private:
  std::set<std::unique_ptr<T>> all_;
};

std::recursive_mutex lock;
CUctx_st primary_context, other_context;
CUstream_st default_stream;
Handles<CUstream_st> streams;
Handles<CUevent_st> events;
Handles<CUmod_st> modules;
Handles<CUfunc_st> functions;
Handles<CUgraph_st> graphs;
Handles<CUgraphExec_st> executables;
std::map<const char*, size_t> pinned;
long long num_waits = 0, num_launches = 0, num_allocations = 0;
uint32_t seed = 1;
size_t memory_limit = size_t(1) << 30, memory_used = 0;

// What every call but the first needs.
int ready() {
  if (!initialized) return NOT_INITIALIZED;
  return current_context == &primary_context ? CUDA_SUCCESS : INVALID_CONTEXT;
}

// The stream of a handle: 0 and 1 are the default one. Null if there is none.
CUstream_st* stream_of(CUstream handle) {
  if (reinterpret_cast<size_t>(handle) <= 1) return &default_stream;
  return streams.has(handle) ? handle : nullptr;
}

void step(CUstream_st& stream) {
  Work work = std::move(stream.queue.front());
  stream.queue.pop_front();
  if (failure.empty()) work();
  ++stream.num_done;
}

int run_until(CUstream_st& stream, long long ticket) {
  while (stream.num_done < ticket) step(stream);
  return failure.empty() ? CUDA_SUCCESS : LAUNCH_FAILED;
}

int run_all() {
  // The newest stream first: whoever relies on an order has to ask for it.
  for (auto stream = streams.all().rbegin(); stream != streams.all().rend(); ++stream)
    run_until(**stream, (*stream)->num_enqueued);
  return run_until(default_stream, default_stream.num_enqueued);
}

int enqueue(CUstream handle, Work work) {
  if (const int error = ready()) return error;
  CUstream_st* stream = stream_of(handle);
  if (!stream) return INVALID_HANDLE;
  if (!failure.empty()) return LAUNCH_FAILED;
  if (stream->recording) {
    stream->recording->work.push_back(std::move(work));
    return CUDA_SUCCESS;
  }
  stream->queue.push_back(std::move(work));
  ++stream->num_enqueued;
  return CUDA_SUCCESS;
}

void break_off(const std::string& message) {
  if (failure.empty()) failure = message;
}

bool is_pinned(const void* p) {
  auto after = pinned.upper_bound(static_cast<const char*>(p));
  if (after == pinned.begin()) return false;
  --after;
  return static_cast<const char*>(p) < after->first + after->second;
}

// The array that holds an address, and the place in it.
simt::Memory* memory_around(CUdeviceptr address, size_t& offset) {
  const char* p = reinterpret_cast<const char*>(address);
  auto after = simt::device_memory.upper_bound(p);
  if (after == simt::device_memory.begin()) return nullptr;
  --after;
  offset = size_t(p - after->first);
  return offset < after->second.bytes ? &after->second : nullptr;
}

// The bytes of an array that work is about to touch; null, with a message, if they are not there.
char* bytes_at(CUdeviceptr address, size_t bytes, const char* what) {
  size_t offset;
  simt::Memory* memory = memory_around(address, offset);
  if (memory && offset + bytes <= memory->bytes) return memory->data + offset;
  break_off(std::string(what) + ": found an array that is " + (memory ? "too short" : "not there (any more)"));
  return nullptr;
}

void define(CUdeviceptr address, size_t bytes) {
  size_t offset;
  simt::Memory& memory = *memory_around(address, offset);
  for (size_t i = offset / memory.grain; i < (offset + bytes + memory.grain - 1) / memory.grain; ++i) {
    memory.words[i] = simt::Word{};
    memory.words[i].defined = true;
  }
}

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

// Kernels of a module: lines "name threads" behind a first line "SIMT", or the code sections of what a compiler made.
bool read_image(const char* image, CUmod_st& module) {
  if (!std::strncmp(image, "SIMT\n", 5)) {
    for (const char* line = image + 5; *line;) {
      const char* space = std::strchr(line, ' ');
      char* end;
      module.threads_of[std::string(line, space)] = unsigned(std::strtoul(space, &end, 10));
      line = *end ? end + 1 : end;
    }
    return true;
  }
  const auto* header = reinterpret_cast<const Elf64_Ehdr*>(image);
  if (std::memcmp(image, ELFMAG, SELFMAG) || header->e_machine != EM_CUDA) return false;
  const auto* sections = reinterpret_cast<const Elf64_Shdr*>(image + header->e_shoff);
  const char* names = image + sections[header->e_shstrndx].sh_offset;
  for (int i = 0; i < header->e_shnum; ++i) {
    const std::string name = names + sections[i].sh_name;
    if (!name.compare(0, 6, ".text.")) module.threads_of[name.substr(6)] = 0;
  }
  return true;
}

}  // namespace

#define LOCKED const std::lock_guard<std::recursive_mutex> locked(lock)
#define NEEDS_CONTEXT \
  LOCKED;             \
  if (const int error = ready()) return error

// For tests.
API void simt_seed(uint32_t value) { seed = value; }
API void simt_interleave(unsigned num_resident) { simt::num_resident = num_resident; }
API long long simt_waits() { return num_waits; }
API long long simt_launches() { return num_launches; }
API long long simt_allocations() { return num_allocations; }
API void simt_forget_failure() {
  LOCKED;
  failure.clear();
  run_all();
  failure.clear();
}
API void simt_limit_memory(size_t bytes) { memory_limit = bytes; }
API void simt_machine(int version, int num_devices, int major, int minor, int init) {
  machine = {version, num_devices, major, minor, init};
}
API void simt_name(CUdeviceptr address, const char* name) {
  size_t offset;
  if (simt::Memory* memory = memory_around(address, offset)) memory->name = name;
}
// Another context, as of another GPU, to be found where it was.
API CUcontext simt_other_context() { return &other_context; }
// What the host holds: arrays, pinned arrays, events, graphs of both kinds.
API void simt_held(long long* counts) {
  counts[0] = (long long)simt::device_memory.size(), counts[1] = (long long)pinned.size();
  counts[2] = (long long)events.all().size();
  counts[3] = (long long)(graphs.all().size() + executables.all().size());
}

CUresult cuInit(unsigned flags) {
  if (flags) return INVALID_VALUE;
  initialized = machine.init == CUDA_SUCCESS;
  return machine.init;
}
CUresult cuDriverGetVersion(int* version) { return *version = machine.version, CUDA_SUCCESS; }
CUresult cuGetErrorName(CUresult error, const char** name) {
  const auto found = ERROR_NAMES.find(error);
  if (found == ERROR_NAMES.end()) return INVALID_VALUE;
  return *name = found->second, CUDA_SUCCESS;
}
CUresult cuGetErrorString(CUresult error, const char** text) {
  if (!ERROR_NAMES.count(error)) return INVALID_VALUE;
  *text = error == LAUNCH_FAILED ? failure.c_str() : "refused by the emulator";
  return CUDA_SUCCESS;
}
CUresult cuDeviceGetCount(int* count) {
  if (!initialized) return NOT_INITIALIZED;
  return *count = machine.num_devices, CUDA_SUCCESS;
}
CUresult cuDeviceGet(CUdevice* device, int ordinal) {
  if (!initialized) return NOT_INITIALIZED;
  return *device = ordinal, ordinal < machine.num_devices ? CUDA_SUCCESS : INVALID_DEVICE;
}
CUresult cuDeviceGetName(char* name, int size, CUdevice) {
  std::strncpy(name, "SIMT emulator", size_t(size));
  return CUDA_SUCCESS;
}
CUresult cuDeviceGetAttribute(int* value, CUdevice_attribute attribute, CUdevice) {
  switch (attribute) {
    case CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT:
      return *value = 2, CUDA_SUCCESS;
    case CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR:
      return *value = machine.major, CUDA_SUCCESS;
    case CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR:
      return *value = machine.minor, CUDA_SUCCESS;
  }
  return INVALID_VALUE;
}
CUresult cuDeviceTotalMem_v2(size_t* bytes, CUdevice) { return *bytes = memory_limit, CUDA_SUCCESS; }
CUresult cuDevicePrimaryCtxRetain(CUcontext* context, CUdevice device) {
  if (!initialized) return NOT_INITIALIZED;
  return *context = &primary_context, device < machine.num_devices ? CUDA_SUCCESS : INVALID_DEVICE;
}
CUresult cuCtxGetCurrent(CUcontext* context) {
  if (!initialized) return NOT_INITIALIZED;
  return *context = current_context, CUDA_SUCCESS;
}
CUresult cuCtxSetCurrent(CUcontext context) {
  if (!initialized) return NOT_INITIALIZED;
  if (context && context != &primary_context && context != &other_context) return INVALID_CONTEXT;
  return current_context = context, CUDA_SUCCESS;
}

CUresult cuModuleLoadData(CUmodule* module, const void* image) {
  NEEDS_CONTEXT;
  ++num_waits;  // code is copied to the device
  *module = modules.add();
  if (read_image(static_cast<const char*>(image), **module)) return CUDA_SUCCESS;
  modules.drop(*module);
  return INVALID_IMAGE;
}
CUresult cuModuleGetFunction(CUfunction* function, CUmodule module, const char* name) {
  NEEDS_CONTEXT;
  if (!modules.has(module)) return INVALID_HANDLE;
  const auto found = module->threads_of.find(name);
  if (found == module->threads_of.end()) return NOT_FOUND;
  Dl_info self;
  dladdr(reinterpret_cast<void*>(&cuInit), &self);
  void* kernel = dlsym(dlopen(self.dli_fname, RTLD_NOW | RTLD_NOLOAD), name);
  if (!kernel) return NOT_FOUND;
  *function = functions.add();
  **function = {name, reinterpret_cast<simt::Kernel>(kernel), found->second};
  return CUDA_SUCCESS;
}

CUresult cuMemAlloc_v2(CUdeviceptr* address, size_t bytes) {
  NEEDS_CONTEXT;
  if (!bytes) return INVALID_VALUE;
  if (memory_used + bytes > memory_limit) return CUDA_ERROR_OUT_OF_MEMORY;
  ++num_allocations;
  memory_used += bytes;
  char* whole = static_cast<char*>(std::aligned_alloc(256, (bytes + 2 * GUARD + 255) / 256 * 256));
  std::memset(whole, GUARD_BYTE, bytes + 2 * GUARD);
  char* data = whole + GUARD;
  std::memset(data, FRESH_BYTE, bytes);
  simt::Memory& memory = simt::device_memory[data];
  memory.name = "array";
  memory.data = data, memory.bytes = bytes;
  memory.words.assign((bytes + 3) / 4, simt::Word{});
  *address = reinterpret_cast<CUdeviceptr>(data);
  return CUDA_SUCCESS;
}
CUresult cuMemFree_v2(CUdeviceptr address) {
  NEEDS_CONTEXT;
  ++num_waits;
  const int result = run_all();
  size_t offset;
  simt::Memory* memory = memory_around(address, offset);
  if (!memory || offset) return INVALID_VALUE;
  char* whole = memory->data - GUARD;
  for (size_t i = 0; i < GUARD; ++i)
    if (whole[i] != GUARD_BYTE || whole[GUARD + memory->bytes + i] != GUARD_BYTE)
      break_off(memory->name + ": found bytes written around it");
  memory_used -= memory->bytes;
  simt::device_memory.erase(memory->data);
  std::free(whole);
  return result;
}
CUresult cuPointerGetAttribute(void* value, CUpointer_attribute attribute, CUdeviceptr address) {
  NEEDS_CONTEXT;
  size_t offset;
  if (attribute != CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL || !memory_around(address, offset)) return INVALID_VALUE;
  return *static_cast<int*>(value) = 0, CUDA_SUCCESS;
}
CUresult cuMemAllocHost_v2(void** address, size_t bytes) {
  NEEDS_CONTEXT;
  ++num_allocations;
  *address = std::calloc(1, bytes);
  pinned[static_cast<char*>(*address)] = bytes;
  return CUDA_SUCCESS;
}
CUresult cuMemFreeHost(void* address) {
  NEEDS_CONTEXT;
  ++num_waits;
  const int result = run_all();
  if (!pinned.erase(static_cast<char*>(address))) return INVALID_VALUE;
  std::free(address);
  return result;
}
CUresult cuMemcpyHtoDAsync_v2(CUdeviceptr to, const void* from, size_t bytes, CUstream handle) {
  NEEDS_CONTEXT;
  CUstream_st* stream = stream_of(handle);
  if (!stream) return INVALID_HANDLE;
  // What is not pinned is taken at once; a device may wait for its stream first.
  std::shared_ptr<std::vector<char>> taken;
  if (!is_pinned(from)) {
    if (stream->recording) break_off("recorded copy to the device: found memory that is not pinned");
    const char* bytes_from = static_cast<const char*>(from);
    taken = std::make_shared<std::vector<char>>(bytes_from, bytes_from + bytes);
    ++num_waits;
  }
  return enqueue(handle, [=] {
    if (!taken && !is_pinned(from)) return break_off("copy to the device: found pinned memory that was freed");
    char* data = bytes_at(to, bytes, "copy to the device");
    if (!data) return;
    std::memcpy(data, taken ? taken->data() : from, bytes);
    define(to, bytes);
  });
}
CUresult cuMemcpyDtoHAsync_v2(void* to, CUdeviceptr from, size_t bytes, CUstream handle) {
  const bool later = is_pinned(to);
  const int result = enqueue(handle, [=] {
    if (later && !is_pinned(to)) return break_off("copy from the device: found pinned memory that was freed");
    if (const char* data = bytes_at(from, bytes, "copy from the device")) std::memcpy(to, data, bytes);
  });
  return result || later ? result : cuStreamSynchronize(handle);
}
CUresult cuMemsetD8Async(CUdeviceptr to, unsigned char value, size_t bytes, CUstream handle) {
  return enqueue(handle, [=] {
    char* data = bytes_at(to, bytes, "memset");
    if (!data) return;
    std::memset(data, value, bytes);
    define(to, bytes);
  });
}

CUresult cuStreamCreate(CUstream* stream, unsigned flags) {
  NEEDS_CONTEXT;
  if (flags != CU_STREAM_NON_BLOCKING) return INVALID_VALUE;  // others wait for the default stream: not played
  return *stream = streams.add(), CUDA_SUCCESS;
}
CUresult cuStreamSynchronize(CUstream handle) {
  NEEDS_CONTEXT;
  CUstream_st* stream = stream_of(handle);
  if (!stream) return INVALID_HANDLE;
  if (stream->recording) return stream->spoiled = true, CAPTURE_UNSUPPORTED;
  ++num_waits;
  return run_until(*stream, stream->num_enqueued);
}
CUresult cuStreamWaitEvent(CUstream stream, CUevent event, unsigned flags) {
  NEEDS_CONTEXT;
  if (!events.has(event)) return INVALID_HANDLE;
  if (flags) return INVALID_VALUE;
  if (!event->stream) return CUDA_SUCCESS;
  CUstream_st* other = event->stream;
  const long long ticket = event->ticket;
  return enqueue(stream, [=] { run_until(*other, ticket); });
}
CUresult cuEventCreate(CUevent* event, unsigned flags) {
  NEEDS_CONTEXT;
  *event = events.add();
  (*event)->timed = !(flags & CU_EVENT_DISABLE_TIMING);
  return CUDA_SUCCESS;
}
CUresult cuEventRecord(CUevent event, CUstream handle) {
  NEEDS_CONTEXT;
  CUstream_st* stream = stream_of(handle);
  if (!events.has(event) || !stream) return INVALID_HANDLE;
  const int result = enqueue(handle, [=] {
    if (events.has(event)) event->seconds = now();
  });
  event->stream = stream, event->ticket = stream->num_enqueued;
  return result;
}
CUresult cuEventQuery(CUevent event) {
  NEEDS_CONTEXT;
  if (!events.has(event)) return INVALID_HANDLE;
  if (!failure.empty()) return LAUNCH_FAILED;
  return !event->stream || event->stream->num_done >= event->ticket ? CUDA_SUCCESS : CUDA_ERROR_NOT_READY;
}
CUresult cuEventSynchronize(CUevent event) {
  NEEDS_CONTEXT;
  if (!events.has(event)) return INVALID_HANDLE;
  ++num_waits;
  return event->stream ? run_until(*event->stream, event->ticket) : CUDA_SUCCESS;
}
CUresult cuEventElapsedTime(float* milliseconds, CUevent from, CUevent to) {
  NEEDS_CONTEXT;
  if (!events.has(from) || !events.has(to) || !from->stream || !to->stream || !from->timed || !to->timed) return INVALID_HANDLE;
  if (cuEventQuery(from) || cuEventQuery(to)) return CUDA_ERROR_NOT_READY;
  *milliseconds = float(1e3 * (to->seconds - from->seconds));
  return CUDA_SUCCESS;
}
CUresult cuEventDestroy_v2(CUevent event) {
  NEEDS_CONTEXT;
  return events.drop(event) ? CUDA_SUCCESS : INVALID_HANDLE;
}

CUresult cuLaunchKernel(CUfunction function, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned block_x,
                        unsigned block_y, unsigned block_z, unsigned shared_bytes, CUstream stream, void** arguments,
                        void** extra) {
  NEEDS_CONTEXT;
  if (!functions.has(function)) return INVALID_HANDLE;
  if (!grid_x || grid_x > 0x7fffffff || grid_y != 1 || grid_z != 1 || !block_x || block_x > 1024 || block_y != 1 ||
      block_z != 1 || shared_bytes || !arguments || extra)
    return INVALID_VALUE;
  if (function->threads && block_x != function->threads)
    break_off(function->name + ": found " + std::to_string(block_x) + " threads a block, built for " +
              std::to_string(function->threads));
  const CUdeviceptr job = *static_cast<CUdeviceptr*>(arguments[0]);
  const int argument = *static_cast<int*>(arguments[1]);
  return enqueue(stream, [=] {
    ++num_launches;
    if (const char* numbers = bytes_at(job, 1, "launch"))
      simt::run_grid(function->kernel, numbers, argument, grid_x, block_x, seed);
    if (!failure.empty() && failure.find(function->name)) failure = function->name + ": " + failure;
  });
}
CUresult cuStreamBeginCapture_v2(CUstream handle, CUstreamCaptureMode mode) {
  NEEDS_CONTEXT;
  CUstream_st* stream = stream_of(handle);
  if (!stream) return INVALID_HANDLE;
  if (stream == &default_stream || stream->recording) return CAPTURE_UNSUPPORTED;
  if (mode != CU_STREAM_CAPTURE_MODE_RELAXED) return INVALID_VALUE;  // what others forbid is not played
  stream->recording = graphs.add(), stream->spoiled = false;
  return CUDA_SUCCESS;
}
CUresult cuStreamEndCapture(CUstream handle, CUgraph* graph) {
  NEEDS_CONTEXT;
  CUstream_st* stream = stream_of(handle);
  if (!stream || !stream->recording) return INVALID_VALUE;
  *graph = stream->recording;
  stream->recording = nullptr;
  if (!stream->spoiled) return CUDA_SUCCESS;
  graphs.drop(*graph);
  *graph = nullptr;
  return CAPTURE_INVALIDATED;
}
CUresult cuGraphInstantiateWithFlags(CUgraphExec* executable, CUgraph graph, unsigned long long flags) {
  NEEDS_CONTEXT;
  if (!graphs.has(graph)) return INVALID_HANDLE;
  if (flags) return INVALID_VALUE;
  *executable = executables.add();
  (*executable)->work = graph->work;
  return CUDA_SUCCESS;
}
CUresult cuGraphDestroy(CUgraph graph) {
  NEEDS_CONTEXT;
  return graphs.drop(graph) ? CUDA_SUCCESS : INVALID_HANDLE;
}
CUresult cuGraphExecDestroy(CUgraphExec executable) {
  NEEDS_CONTEXT;
  return executables.drop(executable) ? CUDA_SUCCESS : INVALID_HANDLE;
}
CUresult cuGraphLaunch(CUgraphExec executable, CUstream stream) {
  NEEDS_CONTEXT;
  if (!executables.has(executable)) return INVALID_HANDLE;
  for (const Work& work : executable->work)
    if (const int result = enqueue(stream, work)) return result;
  return CUDA_SUCCESS;
}

// NVRTC asks a driver that it finds for tables of its own, and goes on without.
API CUresult cuGetExportTable(const void** table, const void*) { return *table = nullptr, NOT_FOUND; }
