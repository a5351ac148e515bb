// reconnect URL TAG COUNT: breaks the socket of a robot COUNT times, with a message after each reconnection, and prints
// the memory of the process at the begin and the end.

#include <chrono>
#include <fstream>

#include "check.hpp"

namespace {

/** Resident memory of this process in KiB. */
long memory() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.compare(0, 6, "VmRSS:") == 0) return std::stol(line.substr(6));
  }
  return 0;
}

}  // namespace

int main(int count, char** words) {
  using namespace contract;
  if (count != 4) {
    std::cerr << "usage: reconnect URL TAG COUNT\n";
    return 2;
  }
  const int times = std::stoi(words[3]), warm = times / 10;
  try {
    World world(words[1], words[2]);
    Pair pair(world);
    auto events = pair.a.events();
    const auto start = std::chrono::steady_clock::now();
    long before = memory();
    for (int number = 0; number < times; ++number) {
      if (number == warm) before = memory();
      rce::ClientAccess::breakSocket(pair.a);
      equal(event(*events, "reconnected"), Value{{"resumed", true}});
      pair.publisher->publish(text(std::to_string(number)), WAIT);
      equal(pair.subscriber->get(WAIT), text(std::to_string(number)));
    }
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    std::cout << times << " reconnections in " << seconds.count() << " s; memory " << before << " KiB after " << warm
              << ", " << memory() << " KiB at the end" << std::endl;
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
}
