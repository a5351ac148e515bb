// Outgoing queues of one socket, one for each interface, served in turns (round robin) so that a large message does not
// delay small ones.
#pragma once

#include <array>
#include <deque>
#include <functional>
#include <limits>
#include <list>
#include <optional>
#include <unordered_map>

#include "codec.hpp"

namespace rce::detail {

constexpr std::size_t PART = 256 * 1024;
constexpr std::size_t HEAD = 40;  // id of 32 hex digits, offset (4 bytes), total (4 bytes)
constexpr std::size_t KEEP_ALL = std::numeric_limits<std::size_t>::max();

/** A frame to write: text, or a part of a blob with its head. It is valid until the next one is taken. */
struct Piece {
  bool isText;
  std::array<std::uint8_t, HEAD> head;
  const void* data;
  std::size_t size;
};

/** A message that is being cut into pieces. */
struct Outgoing {
  Encoded content;
  std::function<void()> onStart{};      // called when its first piece is taken
  std::shared_ptr<const void> ticket{};  // released when it has been written or dropped
  std::size_t blob = 0;
  std::size_t offset = 0;
  bool started = false;

  /** The next piece, or nothing when all of them were taken. */
  std::optional<Piece> next();
};

class Outbox {
 public:
  /** Queue a message; at most `keep` of the source wait. Returns how many older ones were dropped for it. */
  std::size_t put(const std::string& source, Outgoing message, std::size_t keep = KEEP_ALL);

  /** The piece whose turn it is, or nothing. */
  std::optional<Piece> next();

  bool empty() const { return turns_.empty(); }

 private:
  struct Queue {
    std::string source;
    std::deque<Outgoing> messages;
  };

  std::list<Queue> turns_;
  std::unordered_map<std::string, std::list<Queue>::iterator> bySource_;
  std::optional<Outgoing> written_;  // keeps the bytes of the last piece of a message
};

}  // namespace rce::detail
