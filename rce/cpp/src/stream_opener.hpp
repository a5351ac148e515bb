// Opens a TCP connection, and TLS on it where the URL asks for it. Included by the sources that use Beast only.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/ssl/ssl_stream.hpp>

#include "transport.hpp"
#include "url.hpp"

namespace rce::detail {

namespace net = boost::asio;
namespace beast = boost::beast;
using Plain = beast::tcp_stream;
using Secure = beast::ssl_stream<beast::tcp_stream>;

constexpr auto OPEN_TIMEOUT = std::chrono::seconds(10);

/** Resolve, connect and, for a Secure stream, shake hands; then call `done(error_code)`. */
template <class Stream, class Done>
void openStream(net::ip::tcp::resolver& resolver, Stream& stream, const Url& url, Done done) {
  resolver.async_resolve(url.host, url.port, [&stream, url, done](beast::error_code error, auto addresses) {
    if (error) return done(error);
    auto& tcp = beast::get_lowest_layer(stream);
    tcp.expires_after(OPEN_TIMEOUT);
    tcp.async_connect(addresses, [&stream, url, done](beast::error_code failed, const auto&) {
      if (failed) return done(failed);
      beast::get_lowest_layer(stream).socket().set_option(net::ip::tcp::no_delay(true));
      if constexpr (std::is_same_v<Stream, Secure>) {
        stream.set_verify_mode(net::ssl::verify_peer);
        stream.set_verify_callback(net::ssl::host_name_verification(url.host));
        SSL_set_tlsext_host_name(stream.native_handle(), url.host.c_str());
        stream.async_handshake(net::ssl::stream_base::client, done);
      } else {
        done(failed);
      }
    });
  });
}

/** A stream of the kind, not open yet. */
template <class Stream>
Stream makeStream(Transport& transport) {
  if constexpr (std::is_same_v<Stream, Secure>) return Stream(transport.io, transport.tls);
  else return Stream(transport.io);
}

}  // namespace rce::detail
