// What connections are made with.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ssl/context.hpp>

namespace rce::detail {

/** The event loop of a client, which one thread runs, and its trust in certificates. */
struct Transport {
  boost::asio::io_context io{1};
  boost::asio::ssl::context tls{boost::asio::ssl::context::tls_client};
};

}  // namespace rce::detail
