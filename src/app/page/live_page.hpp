// The page of a running instance (docs/page.md), and the thread that serves it.
#pragma once

#include <functional>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "app/control/commands.hpp"
#include "app/control/readers.hpp"
#include "app/control/status_source.hpp"
#include "app/page/page_server.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::app {

/// Serves the page on a thread of its own, with the least priority that shares the processor (nice 19). Of the main
/// loop it needs, while somebody looks, a status each second; events come through the readers' thread, where it counts
/// as two readers, however many look. Once it is made, the main loop waits for the thread only at
/// its end.
///
/// Owner: the program; it is destroyed before what it was made with. Thread: the main loop's.
class LivePage {
 public:
  /// The main loop's side.
  struct Asks {
    StatusSource* status;
    Readers* readers;
    /// Runs a command, and passes on the line that answers it.
    std::function<void(std::vector<std::string> words, std::string by, std::function<void(std::string)> told)> command;
  };
  struct Config {
    PageListener listener;
    PageSettings settings;
    std::string token;        ///< never empty
    std::string socket_path;  ///< of the control socket, beside which the address is kept; empty: nowhere
  };
  /// Throws SetupError.
  LivePage(Loop& loop, Config config, const SystemPlan& plan, Asks asks);
  LivePage(const LivePage&) = delete;
  LivePage& operator=(const LivePage&) = delete;
  ~LivePage();

  /// Another configuration was applied.
  void set(const SystemPlan& plan);
  /// "http://127.0.0.1:8080/"
  const std::string& address() const noexcept { return address_; }
  /// The file, for this user alone, that has the address with the token; empty: none.
  const std::string& file() const noexcept { return file_; }

 private:
  struct Shared;
  class Source;
  struct Setup;
  static Setup setup_of(const SystemPlan& plan);
  void keep_address(const std::string& socket_path, const std::string& token);

  Asks asks_;
  std::string address_, file_;
  std::shared_ptr<Shared> shared_;
  FdWatch from_page_;
  std::thread thread_;
  std::future<void> ended_;
};

}  // namespace rtdata::app
