// Texts that are taken from the environment or from files, and shown nowhere.
#include "has.hpp"
#include "rtdata/config/read.hpp"

#include <doctest/doctest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "app/process.hpp"
#include "config/test_types.hpp"
#include "paths.hpp"
#include "rtdata/config/system.hpp"

using namespace rtdata;
using test::Folder;
using test::Process;

namespace {

constexpr const char* secret = "hunter2-and-more";

struct LoginConfig {
  std::string password = {};
  std::map<std::string, std::string> headers = {};
  SinkConfig sink = {.name = "login"};
  friend constexpr auto parameters(type_tag<LoginConfig>) {
    return parameter_list(parameter("password", &LoginConfig::password, "of the account"),
                          parameter("headers", &LoginConfig::headers, "sent along"),
                          include_member(&LoginConfig::sink));
  }
};

/// Fails, and says with what.
class Leaking final : public Writer {
 public:
  explicit Leaking(std::string password) : password_(std::move(password)) {}
  Result<void> open() override { return {}; }
  Result<void> write(Batch&) override {
    return Error{Errc::not_permitted, "cannot log in", "peer", "wrong password " + password_, "not " + password_};
  }

 private:
  std::string password_;
};

Registry registry(std::vector<LoginConfig>* made = nullptr) {
  Registry types;
  test::add_test_types(types);
  types.add_sink<LoginConfig>(
      "login", "logs in", [](const LoginConfig&) { return std::string(); },
      [made](Loop& loop, const LoginConfig& config) {
        if (made != nullptr) made->push_back(config);
        return Sink(loop, config.sink, std::make_unique<Leaking>(config.password));
      });
  return types;
}

std::string with_sink(const std::string& more) {
  return R"({"sensors": [{"name": "a", "type": "tallied", "rate": "10 Hz"}], "sinks": [{"type": "login")" + more +
         "}]}";
}

using rtdata::test::has;

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("a text is taken from the environment or a file, and the recorded configuration keeps the reference") {
    const Folder folder;
    folder.write("secret", std::string(secret) + "\n");
    ::setenv("RTDATA_TEST_SECRET", secret, 1);
    for (const std::string& reference :
         {std::string(R"({"env": "RTDATA_TEST_SECRET"})"), R"({"file": ")" + folder.path() + "/secret\"}"}) {
      CAPTURE(reference);
      std::vector<LoginConfig> made;
      const Registry types = registry(&made);
      const SystemPlan plan = plan_system(
          types, parse_config(with_sink(R"(, "close_deadline": "0 s", "password": )" + reference +
                                        R"(, "headers": {"x": )" + reference + "}"),
                              "f.json"));
      CHECK(plan.problems.text() == "");
      CHECK(plan.warnings.text() == "");
      CHECK(plan.secrets == std::vector<std::string>{secret, secret});
      CHECK_FALSE(has(plan.runtime_config().configuration, secret));
      Runtime runtime(plan.runtime_config());
      std::vector<std::string> shown;
      runtime.on_log([&](const LogRecord& record) { shown.emplace_back(record.text); });
      Loop loop(runtime, plan.loop_config());
      const System system(loop, types, plan);
      REQUIRE(made.size() == 1);
      CHECK(made[0].password == secret);
      CHECK(made[0].headers.at("x") == secret);
    }
    ::unsetenv("RTDATA_TEST_SECRET");
  }

  TEST_CASE("a secret is in no error, no log and no reason of health") {
    ::setenv("RTDATA_TEST_SECRET", secret, 1);
    const Registry types = registry();
    const SystemPlan plan = plan_system(
        types,
        parse_config(with_sink(R"(, "password": {"env": "RTDATA_TEST_SECRET"}, "close_deadline": "0 s")"), "f.json"));
    ::unsetenv("RTDATA_TEST_SECRET");
    Runtime runtime(plan.runtime_config());
    std::string shown;
    runtime.on_log([&](const LogRecord& record) { shown += std::string(record.text) + "\n"; });
    Loop loop(runtime, plan.loop_config());
    System system(loop, types, plan);
    const Subscription changes = loop.subscribe<HealthChange>("$rtdata/health", [&](const Event<HealthChange>& event) {
      shown += std::string(event->reason.view()) + "\n";
      loop.stop();
    });
    system.sink("login").flush();
    loop.run_for(std::chrono::seconds{10});
    for (const SinkStatus& sink : runtime.sinks()) shown += sink.reason + "\n";
    CHECK(has(shown, "cannot log in"));
    CHECK(has(shown, "wrong password (secret)"));
    CHECK_FALSE(has(shown, secret));
  }

  TEST_CASE("a path that is a secret is in no line of a run, and not in the recording") {
    const Folder folder;
    const std::string hidden = folder.path() + "/hunter2-and-more.db";
    ::setenv("RTDATA_TEST_PATH", hidden.c_str(), 1);
    folder.write("f.json", R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "50 Hz"}],
        "sinks": [{"type": "sqlite", "path": {"env": "RTDATA_TEST_PATH"}}]})");
    Process run(folder, rtdata::test::built("rtdata"), {"run", "f.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    ::unsetenv("RTDATA_TEST_PATH");
    CHECK(std::filesystem::exists(hidden));
    CHECK_FALSE(has(run.out + run.err + folder.read("f.log") + folder.read("hunter2-and-more.db"), "hunter2"));
    CHECK(has(folder.read("hunter2-and-more.db"), "RTDATA_TEST_PATH"));
  }

  TEST_CASE("what cannot be resolved, or may not be a secret, is a mistake; a secret in plain text a warning") {
    const auto planned = [](const std::string& more) {
      return plan_system(registry(), parse_config(with_sink(more), "f.json"));
    };
    const std::string missing = planned(R"(, "password": {"env": "RTDATA_TEST_NO_SUCH_VARIABLE"})").problems.text();
    CHECK(has(missing, "sinks[0].password.env: there is no variable RTDATA_TEST_NO_SUCH_VARIABLE in the environment"));
    CHECK(has(planned(R"(, "password": {"file": "/no/such/file"})").problems.text(),
              "cannot read the secret from /no/such/file"));
    CHECK(has(planned(R"(, "password": {"file": "/"})").problems.text(), "it is not a regular file"));
    CHECK(has(planned(R"(, "password": {"env": "A", "file": "B"})").problems.text(), "expected a string"));
    CHECK(has(planned(R"(, "name": {"env": "HOME"})").problems.text(), "recordings hold this text"));
    CHECK(has(planned(R"(, "topics": [{"env": "HOME"}])").problems.text(), "recordings hold this text"));
    const SystemPlan plain = planned(
        R"(, "password": "hunter2", "headers": {"Authorization": "Bearer x", "Accept": "*/*"})");
    CHECK(plain.good());
    REQUIRE(plain.warnings.size() == 2);
    CHECK(plain.warnings[0].id == "plain-secret");
    CHECK(plain.warnings[0].path == "sinks[0].password");
    CHECK(plain.warnings[1].path == "sinks[0].headers.Authorization");
    CHECK_FALSE(has(plain.warnings.text(), "hunter2"));
    CHECK(has(planned(R"(, "headers": {"x": "https://me:pass@host/a"})").warnings.text(), "looks like a secret"));
    CHECK(planned(R"(, "headers": {"x": "https://host/a@b:c"})").warnings.empty());
  }

  TEST_CASE("short texts are not hidden, since they would be found everywhere") {
    CHECK(hide_secrets("abc abcd", {"abc"}) == "abc abcd");
    CHECK(hide_secrets("abc abcd abcd", {"abcd"}) == "abc (secret) (secret)");
    CHECK(hide_secrets("secretsecret", {"secret"}) == "(secret)(secret)");
  }
}
