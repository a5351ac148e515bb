// Settings of the memory of a program.
#pragma once

namespace rce {

/**
 * Keep freed blocks of up to 32 MB for reuse: for programs that exchange messages of several megabytes.
 *
 * By default malloc of glibc returns large blocks to the system, and each new one costs a page fault for every 4 kB. The
 * setting applies to the whole process, each of whose heaps may then keep 128 MB. Without glibc it has no effect.
 */
void keepLargeBlocks();

}  // namespace rce
