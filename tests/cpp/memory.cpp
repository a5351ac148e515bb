// Counts the page faults of blocks of 8 MB that are allocated again and again, once large blocks are kept.

#include <sys/resource.h>

#include <iostream>
#include <rce/memory.hpp>
#include <vector>

namespace {

constexpr std::size_t BLOCK = 8u << 20;

long pageFaults() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

/** Write to several blocks, which are freed together. */
void useBlocks() { const std::vector<std::vector<char>> blocks(4, std::vector<char>(BLOCK, 'x')); }

}  // namespace

int main() {
  rce::keepLargeBlocks();
  useBlocks();
  const long before = pageFaults();
  for (int count = 0; count < 10; ++count) useBlocks();
  std::cout << pageFaults() - before << " page faults\n";
}
