// Settings of the memory of a program.
#pragma once

namespace rce {

/**
 * Keep freed blocks of up to 32 MB for reuse: for programs that exchange messages of several megabytes.
 *
 * By default glibc returns large blocks to the system, and the page faults of the next ones may take longer than the
 * message. The setting is one of the whole process, which then keeps up to 128 MB. Without glibc it has no effect.
 */
void keepLargeBlocks();

}  // namespace rce
