#include "entry.hpp"

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/version.hpp>

#include <sstream>
#include <utility>

#include "stream_opener.hpp"

namespace rce::detail {
namespace {

namespace http = beast::http;

constexpr const char* VERSION = "20130902";
constexpr std::uint64_t MOST_OF_ANSWER = 65536;

template <class Stream>
class Get : public std::enable_shared_from_this<Get<Stream>> {
 public:
  Get(Transport& transport, Url url, std::string target, std::function<void(unsigned, std::string)> answered,
      std::function<void(std::string)> failed)
      : resolver_(transport.io), stream_(makeStream<Stream>(transport)), url_(std::move(url)),
        request_(http::verb::get, target, 11), answered_(std::move(answered)), failed_(std::move(failed)) {
    request_.set(http::field::host, url_.authority());
    request_.set(http::field::user_agent, "rce-cpp");
    parser_.body_limit(MOST_OF_ANSWER);
  }

  void start() {
    openStream(resolver_, stream_, url_, [self = this->shared_from_this()](beast::error_code error) {
      if (error) return self->failed_(error.message());
      http::async_write(self->stream_, self->request_, [self](beast::error_code failed, std::size_t) {
        if (failed) return self->failed_(failed.message());
        self->read();
      });
    });
  }

 private:
  void read() {
    http::async_read(stream_, buffer_, parser_, [self = this->shared_from_this()](beast::error_code error, std::size_t) {
      if (error) return self->failed_(error.message());
      self->answered_(self->parser_.get().result_int(), self->parser_.get().body());
    });
  }

  net::ip::tcp::resolver resolver_;
  Stream stream_;
  Url url_;
  http::request<http::empty_body> request_;
  http::response_parser<http::string_body> parser_;
  beast::flat_buffer buffer_;
  std::function<void(unsigned, std::string)> answered_;
  std::function<void(std::string)> failed_;
};

}  // namespace

namespace {

/** The texts between commas, without spaces around them. */
std::vector<std::string> separated(const std::string& text) {
  std::vector<std::string> found;
  std::istringstream stream(text);
  for (std::string each; std::getline(stream, each, ',');) {
    const auto begin = each.find_first_not_of(' ');
    if (begin != std::string::npos) found.push_back(each.substr(begin, each.find_last_not_of(' ') - begin + 1));
  }
  return found.empty() ? std::vector<std::string>{text} : found;
}

void locateAt(Transport& transport, const std::string& url, const std::string& user,
              std::function<void(std::string)> found, std::function<void(ErrorInfo)> failed) {
  const Url parsed = Url::parse(url, "http", "https");
  const std::string target = parsed.target({{"userID", user}, {"version", VERSION}});
  auto answered = [url, found = std::move(found), failed](unsigned status, const std::string& body) {
    if (status == 404) return failed({"unavailable", url + " is not the entry of an RCE platform"});
    if (status != 200) return failed(refusal(status, body));
    const std::string endpoint = textOf(Value::parse(body, nullptr, false), "url");
    if (!endpoint.empty()) return found(endpoint);
    failed({"unavailable", url + " is not the entry of an RCE platform: its answer contains no url"});
  };
  auto unreachable = [url, failed](const std::string& reason) {
    failed({"unavailable", "cannot reach " + url + ": " + reason});
  };
  if (parsed.isSecure) std::make_shared<Get<Secure>>(transport, parsed, target, answered, unreachable)->start();
  else std::make_shared<Get<Plain>>(transport, parsed, target, answered, unreachable)->start();
}

/** Answers of several Masters, of which one leads: the first URL counts, or the last failure. */
struct Answers {
  std::size_t missing;
  bool done = false;
};

}  // namespace

void locate(Transport& transport, const std::string& urls, const std::string& user,
            std::function<void(std::string)> found, std::function<void(ErrorInfo)> failed) {
  const auto masters = separated(urls);
  for (const auto& url : masters) Url::parse(url, "http", "https");  // before the first is asked
  const auto answers = std::make_shared<Answers>(Answers{masters.size()});
  for (const auto& url : masters) {
    locateAt(
        transport, url, user,
        [answers, found](const std::string& endpoint) {
          if (!std::exchange(answers->done, true)) found(endpoint);
        },
        [answers, failed](const ErrorInfo& error) {
          const bool isLast = --answers->missing == 0;
          if ((isLast || error.code != "unavailable") && !std::exchange(answers->done, true)) failed(error);
        });
  }
}

ErrorInfo refusal(unsigned status, std::string reason) {
  static const std::map<unsigned, const char*> codes{
      {400, "invalid_request"}, {401, "unauthorized"}, {403, "forbidden"}, {404, "not_found"}, {409, "already_exists"},
      {410, "invalid_request"}, {500, "internal"}, {501, "invalid_request"}};
  const auto code = codes.find(status);
  reason = reason.substr(0, 500);
  while (!reason.empty() && std::isspace(static_cast<unsigned char>(reason.back()))) reason.pop_back();
  if (reason.empty()) reason = "HTTP status " + std::to_string(status);
  return {code == codes.end() ? "unavailable" : code->second, reason};
}

}  // namespace rce::detail
