// Names of peers that are known late, and that come to mean another machine. The names are those of a file of the
// test's own, which lies over /etc/hosts in a process of its own.
#include <doctest/doctest.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>

#include "sinks/answered_senders.hpp"
#include "sinks/killed.hpp"

using namespace sinks;

TEST_SUITE("sinks") {
  TEST_CASE("US-32 a name that is known late, and then is another machine's: all arrives, where the name leads to") {
    for (const AnsweredSender& kind : answered_senders()) {
      CAPTURE(kind.name);
      const Directory directory;
      const int status = status_of([&] {
        const std::string hosts = directory / "hosts";
        const auto know = [&](const char* address) {
          std::ofstream(hosts) << "127.0.0.1 localhost\n" << address << (*address != '\0' ? " peer.test\n" : "");
        };
        know("");
        if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
            ::mount(hosts.c_str(), "/etc/hosts", nullptr, MS_BIND, nullptr) != 0)
          ::_exit(77);
        const auto need = [&](bool is_so, int step) {
          if (!is_so) ::_exit(step);
        };
        AnsweredBench bench(kind, "peer.test");
        bench.publish(10);
        need(bench.wait_for([&] { return bench.sink.health() == Health::faulted; }), 2);
        need(bench.sink.counts().queued == 10, 3);
        bool is_reported = false;
        for (const std::string& error : bench.errors)
          is_reported = is_reported || error.find("peer.test") != error.npos;
        need(is_reported, 4);

        know("127.0.0.1");
        need(bench.wait_for([&] { return bench.sink.counts().stored == 10; }), 5);
        need(bench.has_all() && bench.sink.health() == Health::ok, 6);

        // The machine moves: its name leads elsewhere, and where it was nobody answers any more.
        Peer other(kind.answering, INADDR_LOOPBACK + 1, bench.peer.port());
        know("127.0.0.2");
        bench.peer.leave();
        bench.publish(10);
        need(bench.wait_for([&] {
          other.look();
          return bench.sink.counts().stored == 20;
        }),
             7);
        for (int i = 11; i <= 20; ++i) need(other.got().find("\"value\":" + std::to_string(i)) != std::string::npos, 8);
        need(bench.sink.health() == Health::ok && bench.sink.counts().balances() && bench.missed == 0, 9);
        ::_exit(0);
      });
      if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
        MESSAGE("skipped: mounting over /etc/hosts is not permitted here");
        return;
      }
      CHECK(WIFEXITED(status));
      CHECK(WEXITSTATUS(status) == 0);
    }
  }
}
