#include <iostream>
#include <rce/client.hpp>

int main() {
  rce::Client robot("ann", "secret", "r2d2");
  try {
    robot.connect("http://127.0.0.1:1/").get();
  } catch (const rce::Unavailable& error) {
    std::cout << error.code() << std::endl;
  }
}
