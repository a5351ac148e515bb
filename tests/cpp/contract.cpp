// contract --list: prints the names of the cases. contract URL TAG [CASE...]: runs all cases or these at a real
// platform, and prints the names of those that passed. TAG makes the names of robots unique to a run. RCE_TEST_CA names
// a file of certificates to trust.

#include <cstdlib>

#include "check.hpp"

int main(int count, char** words) {
  using namespace contract;
  Cases cases;
  for (const Cases& more : {topics(), services(), sessions(), robots()}) cases.insert(cases.end(), more.begin(), more.end());
  const std::vector<std::string> arguments(words + 1, words + count);
  if (arguments == std::vector<std::string>{"--list"}) {
    for (const auto& [name, run] : cases) std::cout << name << '\n';
    return 0;
  }
  if (arguments.size() < 2) {
    std::cerr << "usage: contract --list | contract URL TAG [CASE...]\n";
    return 2;
  }
  const char* caFile = std::getenv("RCE_TEST_CA");
  int number = 0, failures = 0;
  for (const auto& [name, run] : cases) {
    ++number;
    if (arguments.size() > 2 && std::find(arguments.begin() + 2, arguments.end(), name) == arguments.end()) continue;
    try {
      World world(arguments[0], arguments[1] + std::to_string(number), caFile ? caFile : "");
      run(world);
      std::cout << name << std::endl;
    } catch (const std::exception& error) {
      std::cerr << "failed: " << name << ": " << error.what() << std::endl;
      ++failures;
    }
  }
  return failures == 0 ? 0 : 1;
}
