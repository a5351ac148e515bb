#include "assembler.hpp"

#include <algorithm>
#include <cctype>

#include "outbox.hpp"

namespace rce::detail {
namespace {

constexpr std::size_t MAX_PENDING = 64;   // incomplete frames, and incomplete blobs
constexpr std::size_t MAX_BLOB = 256u << 20;  // bytes of one blob, which is reserved at its first part
constexpr auto MAX_AGE = std::chrono::seconds(60);

std::size_t bigEndian(const std::uint8_t* from) {
  std::size_t number = 0;
  for (int index = 0; index < 4; ++index) number = number << 8 | from[index];
  return number;
}

}  // namespace

Assembler::Assembler(std::function<void(Value, BlobsById)> complete, std::function<void(ErrorInfo)> failed)
    : complete_(std::move(complete)), failed_(std::move(failed)) {}

void Assembler::addFrame(Value data, std::string_view text) {
  Waiting frame{std::move(data), {}, Clock::now()};
  if (text.find("*\"") != std::string_view::npos) frame.ids = references(frame.data);
  if (isComplete(frame)) return deliver(std::move(frame));
  frames_.push_back(std::move(frame));
  sweep();
}

void Assembler::addBlob(const std::uint8_t* frame, std::size_t size) {
  if (size < HEAD || !std::all_of(frame, frame + 32, [](unsigned char digit) { return std::isxdigit(digit); })) {
    raise({"invalid_request", "a binary frame begins with an id of 32 hex digits"});
  }
  const std::string id(frame, frame + 32);
  const std::size_t offset = bigEndian(frame + 32), total = bigEndian(frame + 36), part = size - HEAD;
  if (offset == 0) blobs_[id] = {{}, total, Clock::now()};
  const auto found = blobs_.find(id);
  if (found == blobs_.end()) return;  // the rest of a blob that was dropped
  Arriving& blob = found->second;
  if (blob.bytes.size() != offset || offset + part > total || total > MAX_BLOB) {
    blobs_.erase(found);
    raise({"invalid_request", "blob " + id + ": the part at " + std::to_string(offset) + " does not continue it"});
  }
  if (offset == 0) blob.bytes.reserve(total);
  blob.bytes.insert(blob.bytes.end(), frame + HEAD, frame + size);
  blob.touched = Clock::now();
  if (blob.bytes.size() < total) return;
  const auto waiting = std::find_if(frames_.begin(), frames_.end(), [&](const Waiting& each) {
    return each.ids.count(id) != 0 && isComplete(each);
  });
  if (waiting != frames_.end()) {
    Waiting ready = std::move(*waiting);
    frames_.erase(waiting);
    deliver(std::move(ready));
  }
  sweep();
}

bool Assembler::isComplete(const Waiting& frame) const {
  return std::all_of(frame.ids.begin(), frame.ids.end(), [this](const std::string& id) {
    const auto blob = blobs_.find(id);
    return blob != blobs_.end() && blob->second.bytes.size() == blob->second.total;
  });
}

void Assembler::deliver(Waiting frame) {
  BlobsById whole;
  for (const std::string& id : frame.ids) {
    const auto blob = blobs_.find(id);
    whole[id] = std::move(blob->second.bytes);
    blobs_.erase(blob);
  }
  complete_(std::move(frame.data), std::move(whole));
}

/** Drop frames and blobs that are too old or too many. */
void Assembler::sweep() {
  const auto oldest = Clock::now() - MAX_AGE;
  for (auto blob = blobs_.begin(); blob != blobs_.end();) {
    blob = blob->second.touched < oldest || blobs_.size() > MAX_PENDING ? blobs_.erase(blob) : std::next(blob);
  }
  for (auto frame = frames_.begin(); frame != frames_.end();) {
    const bool isArriving = std::any_of(frame->ids.begin(), frame->ids.end(), [&](const std::string& id) {
      const auto blob = blobs_.find(id);
      return blob != blobs_.end() && blob->second.touched >= oldest;
    });
    const bool isLate = frame->touched < oldest && !isArriving;
    if (!isLate && frames_.size() <= MAX_PENDING) {
      ++frame;
      continue;
    }
    failed_(isLate ? ErrorInfo{"timed_out", "the blobs of a message for " + textOf(frame->data, "iTag") + " did not arrive"}
                   : ErrorInfo{"limit_exceeded", "too many messages are waiting for their blobs"});
    frame = frames_.erase(frame);
  }
}

}  // namespace rce::detail
