// Connection to a Robot endpoint: a WebSocket with its outbox, whose frames are joined with their blobs.
#pragma once

#include "assembler.hpp"
#include "websocket.hpp"

namespace rce::detail {

class Connection : public WebSocket::Listener, public std::enable_shared_from_this<Connection> {
 public:
  /** Receiver of events, called in the thread of the event loop. */
  class Listener {
   public:
    virtual ~Listener() = default;
    virtual void connectionOpened(Connection& connection, Value session) = 0;
    virtual void connectionRefused(Connection& connection, ErrorInfo error) = 0;
    virtual void messageReceived(Connection& connection, Value data, BlobsById blobs) = 0;
    virtual void statusReceived(Connection& connection, Value frame) = 0;
    virtual void failureReceived(Connection& connection, Value frame) = 0;
    virtual void frameInvalid(Connection& connection, ErrorInfo error) = 0;
    virtual void connectionClosed(Connection& connection, std::string reason) = 0;
  };

  /** Begin to connect; ends with `connectionOpened` or `connectionRefused`. */
  static std::shared_ptr<Connection> open(Transport& transport, const std::string& endpoint, const Query& query,
                                          Listener& listener);

  explicit Connection(std::string endpoint, Listener& listener);

  const std::string& endpoint() const { return endpoint_; }

  /** Queue a message; see `Outbox::put`. */
  std::size_t put(const std::string& source, Outgoing message, std::size_t keep = KEEP_ALL);

  /** Write the queued frames, then close the socket with code 1000, which ends the session. */
  void close();

  /** Break the socket; the platform keeps the session for its grace period. */
  void abort();

  /** Break the socket, and hear nothing more of it. */
  void forget();

 private:
  void refused(unsigned status, std::string reason) override;
  void received(bool isText, const std::uint8_t* data, std::size_t size) override;
  void written() override;
  void closed(std::string reason) override;
  void handleText(PaddedText text);
  void pump();

  std::string endpoint_;
  Listener* listener_;  // null after the end
  std::shared_ptr<WebSocket> socket_;
  Outbox outbox_;
  Assembler assembler_;
  bool hasSession_ = false;
  bool isWriting_ = false;
  bool isClosing_ = false;
};

}  // namespace rce::detail
