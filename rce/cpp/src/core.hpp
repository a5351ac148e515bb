// The robot behind a Client. One thread runs the event loop and owns the session; callbacks have threads of their own.
#pragma once

#include <atomic>
#include <boost/asio/executor_work_guard.hpp>
#include <deque>
#include <functional>
#include <thread>

#include "session.hpp"

namespace rce::detail {

class Core : private Session::Listener, public std::enable_shared_from_this<Core> {
 public:
  explicit Core(Options options);
  ~Core() override;

  const Options& options() const { return options_; }
  bool connected() const { return isOnline_; }

  /** Run a function in the thread of the event loop; after the end, in the caller's thread. */
  void post(std::function<void()> call);

  /** Start a thread that ends when the robot has ended. */
  void spawn(std::function<void()> call);

  /** Start a thread that calls a function with each item of a stream; exceptions become events. */
  template <class Item, class Callback>
  void serve(std::shared_ptr<Stream<Item>> stream, Callback callback) {
    spawn([self = shared_from_this(), stream = std::move(stream), callback = std::move(callback)] {
      try {
        while (auto item = stream->next()) self->guarded([&] { callback(*item); });
      } catch (const Error&) {
        // the methods of the client throw the error that ended the stream
      }
    });
  }

  /** Run a callback of the user; its exception becomes an event. */
  void guarded(const std::function<void()>& callback) noexcept;

  /** End the session and all threads, except the thread that calls this. */
  void stop();

  std::shared_ptr<Stream<Event>> events();
  void publish(Event event);
  void publish(const ErrorInfo& error);

  // In the thread of the event loop.
  Session& session() { return session_; }
  void execute(Command command, Done done, Acknowledged acknowledged = nullptr);
  void opened() { isOnline_ = true; }
  void add(std::shared_ptr<Interface> added, bool isOpen = false);
  void remove(const std::string& tag);
  bool hasInterface(const std::string& tag) const { return interfaces_.count(tag) != 0; }
  bool isUsed(const std::string& service) const { return servicesDeclared_.count(service) != 0; }

  /** Keep what comes for interfaces that begin with this until `adopt`: it may come before it is known which these are. */
  void expect(const std::string& prefix) { early_[prefix]; }
  void adopt(const std::string& prefix);
  bool isDeclared(const std::string& tag) const { return interfacesDeclared_.count(tag) != 0; }

 private:
  void messageReceived(Value data, BlobsById blobs) override;
  void statusReceived(Value data) override;
  void errorReceived(ErrorInfo error) override;
  void disconnected(std::string reason) override;
  void reconnected(bool isResumed, const Value& statuses) override;
  std::vector<Command> declarations() const override;
  void ended(const std::optional<ErrorInfo>& error) override;
  void record(const Command& command);
  void recordExisting(const Command& command);
  bool isOwn(const Value& item) const;
  void forget(const std::function<bool(const std::string&)>& isRemoved);
  void keep(const std::string& tag, std::function<void()> again);
  void drain();

  const Options options_;
  Transport transport_;
  Session session_;
  std::atomic<bool> isOnline_{false};
  std::map<std::string, std::shared_ptr<Interface>> interfaces_;
  std::map<std::string, Command> interfacesDeclared_;  // by `endpoint/interface`
  std::map<std::string, Command> counterpartsDeclared_;  // in environments
  std::map<std::string, Command> connectionsDeclared_;
  std::map<std::string, Command> servicesDeclared_;  // of the catalogue, by tag
  std::map<std::string, std::deque<std::function<void()>>> early_;  // what came, by prefix of the interfaces' tags

  std::mutex readersMutex_;
  std::vector<std::weak_ptr<Stream<Event>>> readers_;
  bool readersEnded_ = false;
  std::optional<ErrorInfo> readersError_;

  struct Worker {
    std::thread thread;
    std::shared_ptr<std::atomic<bool>> isDone;
  };
  std::mutex workersMutex_;
  std::list<Worker> workers_;
  std::mutex stopMutex_;
  std::atomic<bool> isStopped_{false};
  std::recursive_mutex drainMutex_;
  boost::asio::executor_work_guard<boost::asio::io_context::executor_type> work_;
  std::thread loop_;
};

}  // namespace rce::detail
