// A WebSocket, plain or with TLS. Hides Beast, which compiles slowly.
#pragma once

#include <memory>
#include <string>

#include "outbox.hpp"
#include "transport.hpp"
#include "url.hpp"

namespace rce::detail {

class WebSocket {
 public:
  /** Receiver of events, called in the thread of the event loop. */
  class Listener {
   public:
    virtual ~Listener() = default;
    virtual void refused(unsigned status, std::string reason) = 0;
    /** Called with a whole message. PADDING bytes behind its data can be read, too. */
    virtual void received(bool isText, const std::uint8_t* data, std::size_t size) = 0;
    virtual void written() = 0;
    virtual void closed(std::string reason) = 0;
  };

  /** Begin to open a socket. The listener lives until `refused` or `closed`, of which one is called once. */
  static std::shared_ptr<WebSocket> open(Transport& transport, const Url& url, const std::string& target,
                                         std::shared_ptr<Listener> listener);

  virtual ~WebSocket() = default;

  /** Write a piece, whose bytes stay valid until `written`. One at a time. */
  virtual void write(const Piece& piece) = 0;

  /** Close with code 1000. */
  virtual void close() = 0;

  /** Break the connection without a closing handshake. */
  virtual void abort() = 0;
};

}  // namespace rce::detail
