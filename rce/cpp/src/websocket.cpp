#include "websocket.hpp"

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <netinet/tcp.h>

#include "json.hpp"
#include "stream_opener.hpp"

namespace rce::detail {
namespace {

namespace websocket = beast::websocket;
namespace http = beast::http;

constexpr auto SILENCE = std::chrono::seconds(20);     // after which a socket is taken for broken; pings go at half of it
constexpr auto CLOSE_TIMEOUT = std::chrono::seconds(2);
constexpr int WRITE_LIMIT = 64 * 1024;                 // unsent bytes in the kernel, where small frames cannot overtake
constexpr std::size_t WRITE_BUFFER = 64 * 1024;        // bytes that are masked at once
constexpr std::size_t MOST_BYTES = (64u << 20) + PART;  // of one frame of the platform

template <class Stream>
class Socket : public WebSocket, public std::enable_shared_from_this<Socket<Stream>> {
 public:
  Socket(Transport& transport, Url url, std::string target, std::shared_ptr<Listener> listener)
      : resolver_(transport.io), socket_(makeStream<Stream>(transport)), url_(std::move(url)),
        target_(std::move(target)), listener_(std::move(listener)) {}

  void start() {
    openStream(resolver_, socket_.next_layer(), url_, [self = this->shared_from_this()](beast::error_code error) {
      if (error) return self->refuse(0, error.message());
      self->shakeHands();
    });
  }

  void write(const Piece& piece) override {
    socket_.text(piece.isText);
    head_ = piece.head;
    const std::array<net::const_buffer, 2> buffers{net::buffer(head_.data(), piece.isText ? 0 : HEAD),
                                                   net::buffer(piece.data, piece.size)};
    socket_.async_write(buffers, [self = this->shared_from_this()](beast::error_code error, std::size_t) {
      if (self->listener_ && !error) self->listener_->written();  // an error ends the reading, too
    });
  }

  void close() override {
    auto limits = websocket::stream_base::timeout::suggested(beast::role_type::client);
    limits.handshake_timeout = CLOSE_TIMEOUT;
    socket_.set_option(limits);
    socket_.async_close(websocket::close_code::normal, [self = this->shared_from_this()](beast::error_code) {});
  }

  void abort() override {
    resolver_.cancel();
    beast::get_lowest_layer(socket_).close();
  }

 private:
  void shakeHands() {
    auto& tcp = beast::get_lowest_layer(socket_);
    tcp.expires_never();
    ::setsockopt(tcp.socket().native_handle(), IPPROTO_TCP, TCP_NOTSENT_LOWAT, &WRITE_LIMIT, sizeof WRITE_LIMIT);
    socket_.set_option(websocket::stream_base::timeout{OPEN_TIMEOUT, SILENCE, true});
    socket_.auto_fragment(false);
    socket_.write_buffer_bytes(WRITE_BUFFER);
    socket_.read_message_max(MOST_BYTES);
    socket_.async_handshake(response_, url_.authority(), target_, [self = this->shared_from_this()](beast::error_code error) {
      if (error == websocket::error::upgrade_declined) {
        const auto& [reason, phrase] = std::pair(self->response_.body(), std::string(self->response_.reason()));
        return self->refuse(self->response_.result_int(), reason.empty() ? phrase : reason);
      }
      if (error) return self->refuse(0, error.message());
      self->read();
    });
  }

  void refuse(unsigned status, std::string reason) {
    std::exchange(listener_, nullptr)->refused(status, std::move(reason));
  }

  void read() {
    socket_.async_read(buffer_, [self = this->shared_from_this()](beast::error_code error, std::size_t) {
      if (error) {
        const auto& reason = self->socket_.reason();
        return std::exchange(self->listener_, nullptr)->closed(reason.reason.empty() ? error.message() : std::string(reason.reason.c_str()));
      }
      self->buffer_.prepare(PADDING);  // which may move the data
      const auto data = self->buffer_.cdata();
      self->listener_->received(self->socket_.got_text(), static_cast<const std::uint8_t*>(data.data()), data.size());
      self->buffer_.consume(data.size());
      self->read();
    });
  }

  net::ip::tcp::resolver resolver_;
  websocket::stream<Stream, false> socket_;  // without permessage-deflate
  Url url_;
  std::string target_;
  std::shared_ptr<Listener> listener_;
  websocket::response_type response_;
  beast::flat_buffer buffer_;
  std::array<std::uint8_t, HEAD> head_{};
};

}  // namespace

std::shared_ptr<WebSocket> WebSocket::open(Transport& transport, const Url& url, const std::string& target,
                                           std::shared_ptr<Listener> listener) {
  if (url.isSecure) {
    auto socket = std::make_shared<Socket<Secure>>(transport, url, target, std::move(listener));
    socket->start();
    return socket;
  }
  auto socket = std::make_shared<Socket<Plain>>(transport, url, target, std::move(listener));
  socket->start();
  return socket;
}

}  // namespace rce::detail
