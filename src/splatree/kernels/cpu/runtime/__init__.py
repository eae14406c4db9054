"""What all kernels stand on: threads, instruction sets, memory, files."""
