#include "outbox.hpp"

#include <algorithm>

namespace rce::detail {
namespace {

void putBigEndian(std::uint8_t* to, std::size_t number) {
  for (int shift = 24; shift >= 0; shift -= 8) *to++ = static_cast<std::uint8_t>(number >> shift);
}

}  // namespace

std::optional<Piece> Outgoing::next() {
  if (!started) {
    started = true;
    if (onStart) onStart();
    return Piece{true, {}, content.text.data(), content.text.size()};
  }
  if (blob == content.blobs.size()) return std::nullopt;
  const auto& [id, bytes] = content.blobs[blob];
  Piece piece{false, {}, bytes->data() + offset, std::min(PART, bytes->size() - offset)};
  std::copy(id.begin(), id.end(), piece.head.begin());
  putBigEndian(piece.head.data() + 32, offset);
  putBigEndian(piece.head.data() + 36, bytes->size());
  offset += piece.size;
  if (offset == bytes->size()) {
    ++blob;
    offset = 0;
  }
  return piece;
}

std::size_t Outbox::put(const std::string& source, Outgoing message, std::size_t keep) {
  auto found = bySource_.find(source);
  if (found == bySource_.end()) {
    turns_.push_back({source, {}});
    found = bySource_.emplace(source, std::prev(turns_.end())).first;
  }
  auto& messages = found->second->messages;
  messages.push_back(std::move(message));
  std::size_t dropped = 0;
  const std::size_t begun = messages.front().started ? 1 : 0;
  for (; messages.size() - begun > keep; ++dropped) messages.erase(messages.begin() + static_cast<std::ptrdiff_t>(begun));
  return dropped;
}

std::optional<Piece> Outbox::next() {
  written_.reset();
  if (turns_.empty()) return std::nullopt;
  turns_.splice(turns_.end(), turns_, turns_.begin());  // behind the others
  auto& messages = turns_.back().messages;
  Outgoing& message = messages.front();
  const std::optional<Piece> piece = message.next();
  if (message.blob == message.content.blobs.size()) {
    // a short text lies within its string, so its piece is taken anew after the move
    written_.emplace(std::move(message));
    messages.pop_front();
    if (messages.empty()) {
      bySource_.erase(turns_.back().source);
      turns_.pop_back();
    }
    if (piece->isText) return Piece{true, {}, written_->content.text.data(), written_->content.text.size()};
  }
  return piece;
}

}  // namespace rce::detail
