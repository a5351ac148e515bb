// Session of a robot: reconnects whenever the socket breaks, and carries its commands across connections.
//
// A command whose socket breaks before the answer is sent again on the next connection. If the answer to the repetition
// says that the work was done already, the command has succeeded. So a command ends with its own result, with timed_out,
// or with the error by which the platform refused the robot.
#pragma once

#include <boost/asio/steady_timer.hpp>
#include <random>

#include "connection.hpp"
#include "rce/client.hpp"

namespace rce::detail {

/** Called once at the end of an operation, with the error by which it failed, if it did. */
using Done = std::function<void(std::optional<ErrorInfo>)>;

/** Called with the data of an acknowledgement. */
using Acknowledged = std::function<void(const Value&)>;

class Session : private Connection::Listener {
 public:
  class Listener {
   public:
    virtual ~Listener() = default;
    virtual void messageReceived(Value data, BlobsById blobs) = 0;
    virtual void statusReceived(Value data) = 0;
    virtual void errorReceived(ErrorInfo error) = 0;
    virtual void disconnected(std::string reason) = 0;
    virtual void reconnected(bool isResumed, const Value& statuses) = 0;
    virtual std::vector<Command> declarations() const = 0;
    virtual void ended(const std::optional<ErrorInfo>& error) = 0;
  };

  Session(Transport& transport, const Options& options, Listener& listener);

  /** Connect for the first time; may be called again after a failure. */
  void open(const std::string& url, Done done);

  /** Write the queued frames and end the session. */
  void close(Done done);

  /** Send a command; `done` is called when it has been executed, after `acknowledged` if the platform said so. */
  void execute(Command command, Done done, Acknowledged acknowledged = nullptr);

  /** Call a function after a time, unless the timer is destroyed before. */
  std::shared_ptr<boost::asio::steady_timer> after(Seconds seconds, std::function<void()> call);

  /** The open connection, or null while the robot is offline. */
  Connection* connection() const { return connection_.get(); }

  /** For tests: the next connection begins a new session. */
  void forgetToken() { token_.clear(); }

 private:
  enum class State { fresh, opening, open, ended };
  struct Request {
    Command command;
    Done done;
    bool restores;
    Acknowledged acknowledged{};
    int attempts = 0;
    std::shared_ptr<boost::asio::steady_timer> timer{};
  };

  void connectionOpened(Connection& connection, Value session) override;
  void connectionRefused(Connection& connection, ErrorInfo error) override;
  void messageReceived(Connection& connection, Value data, BlobsById blobs) override;
  void statusReceived(Connection& connection, Value frame) override;
  void failureReceived(Connection& connection, Value frame) override;
  void frameInvalid(Connection& connection, ErrorInfo error) override;
  void connectionClosed(Connection& connection, std::string reason) override;

  int submit(Command command, Done done, bool restores, Acknowledged acknowledged = nullptr);
  void send(int id);
  void acknowledge(const Value& frame);
  void finish(int id, const std::optional<ErrorInfo>& error);
  void dial();
  void dialEndpoint(const std::string& endpoint);
  void locateEndpoint();
  void failed(const ErrorInfo& error);
  void retry();
  void restore(bool isResumed);
  bool isUnrestored(const Command& command) const;
  void redeclare(const Command& command, Seconds delay, bool isReported);
  void end(const std::optional<ErrorInfo>& error);

  Transport& transport_;
  const Options options_;
  Listener& listener_;
  std::string url_;
  State state_ = State::fresh;
  Done opened_;
  Done closed_;
  std::shared_ptr<Connection> connection_;
  std::shared_ptr<Connection> attempt_;  // a connection that is being opened
  std::shared_ptr<Connection> closing_;
  std::shared_ptr<boost::asio::steady_timer> retry_;
  std::shared_ptr<boost::asio::steady_timer> closeLimit_;
  std::chrono::steady_clock::time_point openUntil_;
  std::minstd_rand random_{std::random_device{}()};
  Seconds delay_{0};
  int epoch_ = 0;  // number of the connection
  std::map<int, Request> requests_;
  std::vector<Command> unrestored_;  // declarations that are not answered yet, or that are to be repeated
  int lastId_ = 0;
  bool asksEntry_ = false;  // the endpoint that had the session did not answer
  std::string token_;
  std::string endpoint_;
  ErrorInfo error_{"unavailable", "the robot is not connected: call connect() first"};
};

}  // namespace rce::detail
