// Which libraries the program loads, and what it says of those that are not there.
#include <doctest/doctest.h>
#include <sys/stat.h>

#include <csignal>
#include <fstream>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;

namespace {

const std::string loading_program = rtdata::test::built("rtdata");

constexpr const char* of_the_host = R"({
  "sensors": [ {"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"} ],
  "sinks": [ {"type": "sqlite", "path": "run.db"} ]
})";

bool is_in(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

struct Late {
  std::string part;     // as --version calls it
  std::string begins;   // of its error
  std::string name;     // as its error calls it
  std::string soname;   // up to the version
  std::string package;  // as far as it is always the same
  std::vector<std::string> configurations;
};

const std::vector<Late>& late_libraries() {
  static const std::vector<Late> all{
      {"HTTP",
       "type http",
       "libcurl",
       "libcurl.so.",
       "libcurl4",
       {R"({"sinks": [ {"type": "http", "url": "http://127.0.0.1:9/"} ]})",
        R"({"sensors": [ {"name": "plug", "type": "http", "rate": "1 Hz", "url": "http://127.0.0.1:9/",
            "fields": [ {"name": "x"} ]} ]})",
        R"({"outputs": [ {"name": "lamp", "type": "http", "url": "http://127.0.0.1:9/{value}", "method": "get",
            "safe": 0} ]})"}},
      {"MQTT",
       "type mqtt",
       "libmosquitto",
       "libmosquitto.so.",
       "libmosquitto1",
       {R"({"sinks": [ {"type": "mqtt", "host": "127.0.0.1", "topic": "a"} ]})",
        R"({"sensors": [ {"name": "phone", "type": "mqtt", "host": "127.0.0.1", "topics": ["a"],
            "fields": [ {"name": "x"} ]} ]})",
        R"({"outputs": [ {"name": "lamp", "type": "mqtt", "host": "127.0.0.1", "to": "a", "text": "{value}",
            "safe": 0} ]})"}},
      {"Modbus",
       "type modbus",
       "libmodbus",
       "libmodbus.so.",
       "libmodbus5",
       {R"({"buses": {"meters": {"type": "modbus", "host": "127.0.0.1"}},
            "sensors": [ {"name": "meter", "type": "modbus", "bus": "meters", "rate": "1 Hz",
                          "fields": [ {"name": "power", "address": 0} ]} ]})"}},
      {"PostgreSQL",
       "type postgresql",
       "libpq",
       "libpq.so.",
       "libpq5",
       {R"({"sinks": [ {"type": "postgresql", "url": "postgresql://127.0.0.1:9/plant"} ]})"}},
      {"pattern",
       "`pattern`",
       "PCRE2",
       "libpcre2-8.so.",
       "libpcre2-8-0",
       {R"({"sensors": [ {"name": "scale", "type": "serial", "device": "/dev/none", "format": "pattern",
                          "pattern": "(?<x>.+) V", "fields": [ {"name": "x"} ]} ]})",
        R"({"sensors": [ {"name": "scale", "type": "udp", "port": 9, "only": {"pattern": "x"},
                          "fields": [ {"name": "x"} ]} ]})"}},
      {"TLS",
       "`tls`",
       "OpenSSL",
       "libssl.so.",
       "libssl",
       {R"({"sinks": [ {"type": "tcp", "host": "127.0.0.1", "port": 9, "tls": {}} ]})"}}};
  return all;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-5 --version lists the parts that are in, with their libraries' versions, and those left out") {
    const Folder folder;
    Process version(folder, loading_program, {"--version"});
    CHECK(version.end() == 0);
    CHECK(version.out.starts_with("rtdata "));
    for (const auto& named : std::vector<std::pair<std::string, std::string>>{{"SQLite", "SQLite"},
                                                                              {"GPIO", "libgpiod"},
                                                                              {"Modbus", "libmodbus"},
                                                                              {"PostgreSQL", "libpq"},
                                                                              {"HTTP", "libcurl"},
                                                                              {"MQTT", "libmosquitto"},
                                                                              {"TLS", "OpenSSL"},
                                                                              {"page", "libmicrohttpd"},
                                                                              {"pattern", "PCRE2"}}) {
      const std::string part = named.first, library = named.second;  // no bindings: clang 14 lets no lambda have them
      const std::string in = "\n  " + part + ": " + library + " ";
      const std::size_t at = version.out.find(in);
      const bool has_version = at != std::string::npos && std::isdigit(version.out[at + in.size()]) != 0;
      const bool is_left_out = is_in(version.out, "\n  " + part + ": left out, built without " + library + " (lib");
      CHECK_MESSAGE(has_version != is_left_out, part, " in ", version.out);
    }
  }

  TEST_CASE("a configuration that records the host loads no library of servers, buses or encryption") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("host.json", of_the_host);
    Process run(folder, loading_program, {"run", "host.json"});
    REQUIRE(run.wait_for("running host"));
    const auto instances = rtdata::app::running_instances();
    REQUIRE(instances.size() == 1);
    std::string maps = content_of("/proc/" + std::to_string(instances[0].pid) + "/maps");
    CHECK(is_in(maps, "libsqlite3.so."));
    for (const Late& late : late_libraries()) CHECK_FALSE(is_in(maps, "/" + late.soname));
    for (const char* soname : {"/libcrypto.so.", "/libz.so.", "/libmicrohttpd.so.", "/libgnutls.so."})
      CHECK_FALSE(is_in(maps, soname));
    run.signal(SIGINT);
    CHECK(run.end() == 0);
    if (std::getenv("RTDATA_TEST_EMULATOR") != nullptr) return;  // the loader would tell of the emulator's libraries
    for (const std::string command : {"types", "types --schema", "init new.json", "check host.json", "--version"}) {
      Process told(folder, "/bin/sh", {"-c", "LD_DEBUG=files exec " + loading_program + " " + command});
      CHECK(told.end() == 0);
      CHECK(is_in(told.err, "libsqlite3.so."));
      for (const Late& late : late_libraries()) CHECK_FALSE_MESSAGE(is_in(told.err, late.soname), command);
    }
  }

  TEST_CASE("NFR-5 a library that is not there is a mistake where a configuration uses it, for check and for run") {
    const RuntimeFolder runtime;
    const Folder folder;
    Process version(folder, loading_program, {"--version"});
    REQUIRE(version.end() == 0);
    // The program as it is, but that it asks for versions of them which nobody has.
    std::string bytes = content_of(loading_program);
    for (const Late& late : late_libraries()) {
      for (const std::string& soname : {late.soname, std::string("libcurl-gnutls.so.")}) {
        for (std::size_t at = bytes.find(soname); at != std::string::npos; at = bytes.find(soname, at + 1))
          bytes[at + soname.size()] = 'x';
      }
    }
    folder.write("lacking", bytes);
    const std::string lacking = folder.path() + "/lacking";
    REQUIRE(::chmod(lacking.c_str(), 0700) == 0);
    folder.write("host.json", of_the_host);
    Process host(folder, lacking, {"run", "host.json", "--for", "100ms"});
    CHECK_MESSAGE(host.end() == 0, host.err);
    for (const Late& late : late_libraries()) {
      if (is_in(version.out, late.part + ": left out")) continue;
      for (const std::string& configuration : late.configurations) {
        folder.write("used.json", configuration);
        Process good(folder, loading_program, {"check", "used.json"});
        CHECK_MESSAGE(good.end() == 0, good.out, good.err);
        for (const char* command : {"check", "run"}) {
          Process refused(folder, lacking, {command, "used.json"});
          CHECK(refused.end() == 2);
          CHECK_MESSAGE(
              is_in(refused.out + refused.err,
                    late.begins + ": " + late.name + " is not installed (" + late.soname +
                        "x: cannot open shared object file: No such file or directory): apt install " + late.package),
              refused.out, refused.err);
        }
      }
    }
  }
}
