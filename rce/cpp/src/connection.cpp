#include "connection.hpp"

#include "entry.hpp"

namespace rce::detail {

std::shared_ptr<Connection> Connection::open(Transport& transport, const std::string& endpoint, const Query& query,
                                             Listener& listener) {
  const Url url = Url::parse(endpoint, "ws", "wss");
  auto connection = std::make_shared<Connection>(endpoint, listener);
  connection->socket_ = WebSocket::open(transport, url, url.target(query), connection);
  return connection;
}

Connection::Connection(std::string endpoint, Listener& listener)
    : endpoint_(std::move(endpoint)), listener_(&listener),
      assembler_([this](Value data, BlobsById blobs) { listener_->messageReceived(*this, std::move(data), std::move(blobs)); },
                 [this](ErrorInfo error) { listener_->frameInvalid(*this, std::move(error)); }) {}

std::size_t Connection::put(const std::string& source, Outgoing message, std::size_t keep) {
  const std::size_t dropped = outbox_.put(source, std::move(message), keep);
  pump();
  return dropped;
}

void Connection::close() {
  isClosing_ = true;
  pump();
}

void Connection::abort() {
  if (socket_) socket_->abort();
}

void Connection::forget() {
  listener_ = nullptr;
  abort();
}

void Connection::pump() {
  if (isWriting_ || !socket_) return;
  if (const auto piece = outbox_.next()) {
    isWriting_ = true;
    socket_->write(*piece);
  } else if (isClosing_) {
    isWriting_ = true;  // nothing is written any more
    socket_->close();
  }
}

void Connection::written() {
  isWriting_ = false;
  pump();
}

void Connection::refused(unsigned status, std::string reason) {
  socket_.reset();
  if (!listener_) return;
  listener_->connectionRefused(*this, status != 0 ? refusal(status, std::move(reason))
                                                  : ErrorInfo{"unavailable", "cannot reach " + endpoint_ + ": " + reason});
}

void Connection::received(bool isText, const std::uint8_t* data, std::size_t size) {
  if (!listener_) return;
  try {
    if (isText) handleText({{reinterpret_cast<const char*>(data), size}});
    else assembler_.addBlob(data, size);
  } catch (const Error& error) {
    if (listener_) listener_->frameInvalid(*this, error.info());
  } catch (const Value::exception& error) {  // an item of another type than the protocol says
    if (listener_) listener_->frameInvalid(*this, {"invalid_request", std::string("the server sent a malformed frame: ") + error.what()});
  }
}

void Connection::handleText(PaddedText text) {
  Value frame = decode(text);
  const std::string type = textOf(frame, "type");
  if (!hasSession_) {
    hasSession_ = type == "ST" && textOf(frame["data"], "topic") == "session";
    if (hasSession_) return listener_->connectionOpened(*this, std::move(frame["data"]));
    Listener& listener = *listener_;
    forget();
    return listener.connectionRefused(*this, {"unavailable", "the first frame of " + endpoint_ + " is not a session status"});
  }
  if (type == "DM") assembler_.addFrame(std::move(frame["data"]), text.text);
  else if (type == "ST") listener_->statusReceived(*this, std::move(frame));
  else if (type == "ER") listener_->failureReceived(*this, std::move(frame));
}

void Connection::closed(std::string reason) {
  socket_.reset();
  outbox_ = Outbox();
  if (!listener_) return;
  if (hasSession_) listener_->connectionClosed(*this, std::move(reason));
  else listener_->connectionRefused(*this, {"unavailable", endpoint_ + " sent no session status: " + reason});
}

}  // namespace rce::detail
