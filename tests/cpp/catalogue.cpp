// catalogue URL TAG SERVICE: uses a service of the catalogue that answers on `heard` what it takes on `say`, also in a
// new session, and leaves it. Prints its name.

#include "check.hpp"

int main(int count, char** words) {
  using namespace contract;
  if (count != 4) {
    std::cerr << "usage: catalogue URL TAG SERVICE\n";
    return 2;
  }
  try {
    World world(words[1], words[2]);
    rce::Client& robot = world.robot("a");
    const std::string name = words[3];
    throws<rce::NotFound>([&] { robot.use("nobody/nothing"); });
    const auto service = robot.use(name, "cpp");
    throws<rce::AlreadyExists>([&] { robot.use(name, "cpp"); });
    throws<rce::NotFound>([&] { service->publisher("heard"); }, "has no publisher heard");
    service->publisher("say")->publish(text("hello"), WAIT);
    equal(service->subscriber("heard")->get(WAIT), text("hello"));

    auto events = robot.events();
    rce::ClientAccess::endSession(robot);
    equal(event(*events, "reconnected"), Value{{"resumed", false}});
    for (bool isBack = false; !isBack;) {  // the service is asked for again after the event
      service->publisher("say")->publish(text("again"), WAIT);
      try {
        isBack = service->subscriber("heard")->get(rce::Seconds(1)) == text("again");
      } catch (const rce::TimedOut&) {
      }
    }
    const auto heard = service->subscriber("heard");
    service->leave();
    throws<rce::Unavailable>([&] {
      for (;;) heard->get(WAIT);
    });
    service->leave();  // once more does no harm
    robot.use(name, "cpp")->leave();
    std::cout << service->name() << ' ' << service->tag() << ' ' << (service->isShared() ? "shared" : "own") << std::endl;
    return 0;
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
    return 1;
  }
}
