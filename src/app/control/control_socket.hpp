// The local socket of a running instance: one line of JSON in, one line of JSON out. Only the user of the instance and
// root can connect, because only they can enter its folder.
//
// The socket is PID.sock in the first of these folders that can be used, made with mode 0700 and owned by the user:
// $XDG_RUNTIME_DIR/rtdata, /run/rtdata, /tmp/rtdata-UID; or in $RTDATA_RUNTIME_DIR and no other, when that is set.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/detail/io/descriptor.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/loop.hpp"

struct uv_pipe_s;

namespace rtdata::app {

/// Accepts connections on its loop and answers their lines. It never waits, and its memory is bounded: at most 8
/// clients, lines of at most 64 KiB, one line of each client every 20 ms, and one answer at a time. It disconnects a
/// client that does not read an answer for 5 s or sends a longer line. If there is a ninth client, it disconnects the
/// longest silent client that does not wait for an answer, so that idle connections do not block others and each
/// command gets its answer. If all wait for an answer, it tells the new client so and disconnects it.
///
/// Thread: the loop's, for everything. The process ignores SIGPIPE.
class ControlSocket {
 public:
  static constexpr std::size_t most_clients = 8;
  static constexpr std::size_t longest_line = 64 * 1024;

  /// Makes the text of the answer, without the line end, on the socket's own thread.
  using Work = std::function<std::string()>;
  /// Collects the data for the answer on the loop, quickly, and returns the rest as Work. `client` numbers the
  /// connections from 1. Empty Work: `take_over` was called.
  using Answer = std::function<Work(std::uint64_t client, std::string_view line)>;
  using Gone = std::function<void(std::uint64_t client)>;
  /// Opens the socket, and removes sockets of ended processes. SetupError if no folder can be used; the program can run
  /// without.
  ControlSocket(Loop& loop, Answer answer, Gone gone);
  ControlSocket(const ControlSocket&) = delete;
  ControlSocket& operator=(const ControlSocket&) = delete;
  ~ControlSocket();

  const std::string& path() const noexcept { return path_; }
  /// The client according to the kernel: "uid 1000, pid 4711"; "somebody" after the connection has ended.
  std::string peer_of(std::uint64_t client) noexcept;
  /// To be called while it is answered: the connection as a descriptor of the caller's, which does not block. The
  /// socket no longer knows the client, and ignores what it sent after the line. -1: there is no descriptor, and
  /// it stays.
  int take_over(std::uint64_t client) noexcept;

 private:
  struct Client;
  struct Job;
  void listen();
  void accept();
  bool make_room();
  Client* find(std::uint64_t number) noexcept;
  void drop(Client& client);
  void received(Client& client, std::ptrdiff_t size);
  /// Answers the next line, if it is complete. False: disconnect the client.
  bool answer_next(Client& client);
  void answered(std::uint64_t number, std::string text);
  void sent(Client& client, int status);
  void timed_out(std::uint64_t number);

  Loop& loop_;
  Answer answer_;
  Gone gone_;
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);  // for jobs that end late
  /// Answers are made on several lanes, since some take seconds (a tare) and others must not wait (to disarm).
  struct AnswerLane {
    AnswerLane(detail::LoopCore& loop, Duration patience) : lane(loop, "control", patience) {}
    detail::Lane lane;
    std::size_t answers = 0;  // that are being made
  };
  std::list<AnswerLane> lanes_;
  std::string path_;
  uv_pipe_s* server_ = nullptr;  // freed by libuv, as the clients are
  std::uint64_t last_number_ = 0;
  std::vector<Client*> clients_;
  std::array<char, 16 * 1024> buffer_;  // of the text that is being read
};

/// A running instance, found by its socket.
struct Instance {
  pid_t pid = 0;
  std::string path;
};
/// The instances whose sockets this user may use, by pid, also one that accepts no connection now. Skips sockets of
/// ended processes.
std::vector<Instance> running_instances();
/// Folders that may have more instances but that this user may not read: services of other users.
std::vector<std::string> closed_folders();

/// The other side of a ControlSocket. Move-only.
class ControlClient {
 public:
  /// Does not block. Errors: busy (too many clients connect), those of the system.
  static Result<ControlClient> connect(const std::string& path);
  /// Sends a line and waits for its answer for `at_most`.
  Result<std::string> ask(std::string_view line, Duration at_most);
  /// Sends as much of a line as possible without blocking; `receive` sends the rest.
  void send(std::string_view line);
  /// Waits for the next answer for `at_most`; empty: it has not come yet.
  Result<std::optional<std::string>> receive(Duration at_most);

 private:
  explicit ControlClient(int fd) : fd_(fd) {}
  void send_more();
  detail::Descriptor fd_;
  std::string out_;   // not sent yet
  std::string rest_;  // received, but not a complete answer yet
};

}  // namespace rtdata::app
