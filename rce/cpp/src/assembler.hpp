// Joins the text and binary frames of one connection, in whichever order they arrive.
#pragma once

#include <chrono>
#include <functional>
#include <list>

#include "codec.hpp"

namespace rce::detail {

class Assembler {
 public:
  /** `complete` is called with each complete DM, `failed` for one whose blobs did not arrive. */
  Assembler(std::function<void(Value, BlobsById)> complete, std::function<void(ErrorInfo)> failed);

  /** Add the `data` of a DM; `text` is the frame from which it was decoded. */
  void addFrame(Value data, std::string_view text);

  /** Add a binary frame. Throws InvalidRequest if it is malformed or out of order. */
  void addBlob(const std::uint8_t* frame, std::size_t size);

 private:
  using Clock = std::chrono::steady_clock;
  struct Waiting {
    Value data;
    std::set<std::string> ids;
    Clock::time_point touched;
  };
  struct Arriving {
    Bytes bytes;
    std::size_t total;
    Clock::time_point touched;
  };

  bool isComplete(const Waiting& frame) const;
  void deliver(Waiting frame);
  void sweep();

  std::function<void(Value, BlobsById)> complete_;
  std::function<void(ErrorInfo)> failed_;
  std::list<Waiting> frames_;
  std::map<std::string, Arriving> blobs_;
};

}  // namespace rce::detail
