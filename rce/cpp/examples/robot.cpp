// A robot that starts an environment with an echo node, talks to it, and offers a service to other robots.
//
//   rce_robot URL USER PASSWORD

#include <iostream>
#include <rce/client.hpp>

int main(int count, char** words) {
  if (count != 4) {
    std::cerr << "usage: rce_robot URL USER PASSWORD\n";
    return 2;
  }
  try {
    rce::Client robot(words[2], words[3], "cppbot");
    robot.connect(words[1]).get();
    robot.onEvent([](const rce::Event& event) { std::cerr << event.topic << ' ' << event.data << '\n'; });

    auto land = robot.environment("cppland");
    land.create(true);
    land.addNode("echo", "rce_demo", "echo.py", "", "", "", {{"existOk", true}}).get();
    auto heard = land.subscriber("/heard", "std_msgs/String");
    auto say = land.publisher("/say", "std_msgs/String");
    auto gripper = robot.provider("gripper", "std_srvs/SetBool", [](const rce::Value& request, rce::Value& response) {
      response = {{"success", true}, {"message", request["data"] ? "open" : "closed"}};
      return true;
    });

    for (std::optional<rce::Value> answer; !answer;) {  // until the node is running
      say->publish({{"data", "hello"}});
      try {
        answer = heard->get(rce::Seconds(0.5));
        std::cout << "the node answered: " << answer->at("data").get<std::string>() << std::endl;
      } catch (const rce::TimedOut&) {
      }
    }
    land.destroy().get();
  } catch (const rce::Error& error) {
    std::cerr << error.code() << ": " << error.what() << '\n';
    return 1;
  }
}
