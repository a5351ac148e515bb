// The Master's entry, which assigns an endpoint to a robot.
#pragma once

#include <functional>

#include "codec.hpp"
#include "transport.hpp"
#include "url.hpp"

namespace rce::detail {

/**
 * GET the entry; `found` gets the URL of the Robot endpoint, `failed` the reason. Those of several Masters are
 * separated by commas, and all are asked: the one that leads answers. Throws InvalidRequest.
 */
void locate(Transport& transport, const std::string& urls, const std::string& user,
            std::function<void(std::string)> found, std::function<void(ErrorInfo)> failed);

/** The error for an HTTP status of the entry or the handshake. */
ErrorInfo refusal(unsigned status, std::string reason);

}  // namespace rce::detail
