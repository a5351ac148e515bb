// Bounded queue that keeps the newest items, for one or more readers.
#pragma once

#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "rce/errors.hpp"

namespace rce {

/** Wait until the condition holds; false if it does not within the timeout. */
template <class Condition>
bool waitFor(std::condition_variable& changed, std::unique_lock<std::mutex>& lock, Seconds timeout, Condition holds) {
  if (timeout < forever) return changed.wait_for(lock, timeout, holds);
  changed.wait(lock, holds);
  return true;
}

/** Queue of items in the order of their arrival; each item goes to one reader. Thread-safe. */
template <class Item>
class Stream {
 public:
  explicit Stream(std::size_t depth) : depth_(depth) {}

  /** Add an item; the oldest is dropped if more than the depth are unread. */
  void put(Item item) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (ended_) return;
    items_.push_back(std::move(item));
    if (items_.size() > depth_) {
      items_.pop_front();
      ++dropped_;
    }
    changed_.notify_one();
  }

  /** End the stream: readers get the remaining items, then the error or the end. */
  void end(std::optional<ErrorInfo> error = std::nullopt) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (ended_) return;
    ended_ = true;
    error_ = std::move(error);
    changed_.notify_all();
  }

  /** The next item, or nothing after the end. Throws TimedOut, and the error with which the stream ended. */
  std::optional<Item> next(Seconds timeout = forever) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!waitFor(changed_, lock, timeout, [this] { return ended_ || !items_.empty(); })) {
      raise({"timed_out", "nothing arrived within " + std::to_string(timeout.count()) + " s"});
    }
    if (items_.empty()) {
      if (error_) raise(*error_);
      return std::nullopt;
    }
    std::optional<Item> item(std::move(items_.front()));
    items_.pop_front();
    return item;
  }

  /** The next item. Throws as `next`, and Unavailable after the end. */
  Item get(Seconds timeout = forever) {
    std::optional<Item> item = next(timeout);
    if (!item) raise({"unavailable", "nothing more will arrive: the stream has been closed"});
    return std::move(*item);
  }

  /** Number of items that were dropped. */
  std::size_t dropped() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return dropped_;
  }

 private:
  const std::size_t depth_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> items_;
  std::size_t dropped_ = 0;
  bool ended_ = false;
  std::optional<ErrorInfo> error_;
};

}  // namespace rce
