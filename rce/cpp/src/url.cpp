#include "url.hpp"

#include <openssl/sha.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "rce/errors.hpp"

namespace rce::detail {
namespace {

constexpr const char* DIGITS = "0123456789abcdef";

std::string hex(unsigned char byte) { return {DIGITS[byte >> 4], DIGITS[byte & 15]}; }

std::string percentEncoded(const std::string& text) {
  std::string encoded;
  for (const char letter : text) {
    const auto byte = static_cast<unsigned char>(letter);
    if (std::isalnum(byte) || byte == '-' || byte == '_' || byte == '.' || byte == '~') {
      encoded += letter;
    } else {
      encoded += '%' + hex(byte);
    }
  }
  return encoded;
}

}  // namespace

Url Url::parse(const std::string& text, const std::string& plain, const std::string& secure) {
  const auto fail = [&] {
    raise({"invalid_request", "url '" + text + "' must have the form " + plain + "://HOST:PORT/ or " + secure + "://…", "", "url"});
  };
  const auto colon = text.find("://");
  const std::string scheme = text.substr(0, colon);
  if (colon == std::string::npos || (scheme != plain && scheme != secure)) fail();
  const std::string rest = text.substr(colon + 3, text.find_first_of("?#", colon) - colon - 3);
  const auto slash = std::min(rest.find('/'), rest.size());
  const std::string authority = rest.substr(0, slash);
  const auto mark = authority.rfind(':'), bracket = authority.rfind(']');
  const bool hasPort = mark != std::string::npos && (bracket == std::string::npos || mark > bracket);
  std::string host = authority.substr(0, hasPort ? mark : std::string::npos);
  if (bracket != std::string::npos && host.size() > 2) host = host.substr(1, host.size() - 2);
  const bool isSecure = scheme == secure;
  const std::string port = hasPort ? authority.substr(mark + 1) : isSecure ? "443" : "80";
  const bool isNumber = !port.empty() && port.find_first_not_of("0123456789") == std::string::npos;
  if (host.empty() || !isNumber || host.find('@') != std::string::npos) fail();
  return {isSecure, host, port, slash < rest.size() ? rest.substr(slash) : "/"};
}

std::string Url::target(const Query& query) const {
  std::string text = path;
  char separator = '?';
  for (const auto& [name, value] : query) {
    text += separator + name + '=' + percentEncoded(value);
    separator = '&';
  }
  return text;
}

std::string Url::authority() const {
  return (host.find(':') == std::string::npos ? host : '[' + host + ']') + ':' + port;
}

std::string sha256(const std::string& text) {
  std::array<unsigned char, SHA256_DIGEST_LENGTH> digest;
  SHA256(reinterpret_cast<const unsigned char*>(text.data()), text.size(), digest.data());
  std::string digits;
  for (const unsigned char byte : digest) digits += hex(byte);
  return digits;
}

}  // namespace rce::detail
