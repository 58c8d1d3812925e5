#include "app/control/control_socket.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>
#include <uv.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "app/control/request.hpp"
#include "data/number_text.hpp"
#include "loop/core/loop_core.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {
namespace {

constexpr int answer_lanes = 4;
constexpr Duration pause = std::chrono::milliseconds{20};
constexpr std::size_t longest_answer = std::size_t{256} << 20;
constexpr int most_after_end = 8;  // lines of a client that has closed its side, answered without a pause
constexpr Duration client_patience = std::chrono::seconds{5};

/// The variable if it is an absolute path, or the first of several separated by ':'; otherwise empty.
std::string folder_in(const char* variable) {
  const char* const value = std::getenv(variable);
  return value != nullptr && value[0] == '/' ? std::string(value, std::strcspn(value, ":")) : std::string();
}

/// The possible folders of sockets, best first.
std::vector<std::string> folders() {
  std::vector<std::string> all;
  if (std::string only = folder_in("RTDATA_RUNTIME_DIR"); !only.empty()) return {std::move(only)};
  // The folder of a service, made by systemd below /run; the service's /tmp may be private.
  if (std::string service = folder_in("RUNTIME_DIRECTORY"); !service.empty()) all.push_back(std::move(service));
  if (const std::string user = folder_in("XDG_RUNTIME_DIR"); !user.empty()) all.push_back(user + "/rtdata");
  all.push_back("/run/rtdata");
  all.push_back("/tmp/rtdata-" + std::to_string(::geteuid()));
  return all;
}

/// The folders and their subfolders: each service has its own.
std::vector<std::string> folders_to_search() {
  std::vector<std::string> all;
  for (std::string& folder : folders()) {
    std::error_code none;
    for (const auto& entry : std::filesystem::directory_iterator(folder, none)) {
      if (std::filesystem::is_directory(entry.symlink_status(none))) all.push_back(entry.path());
    }
    all.push_back(std::move(folder));
  }
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  return all;
}

/// True if this user owns the folder and no other user can write to it.
bool is_private(const std::string& folder) {
  struct stat found {};
  return ::lstat(folder.c_str(), &found) == 0 && S_ISDIR(found.st_mode) && found.st_uid == ::geteuid() &&
         (found.st_mode & 077) == 0;
}

bool address_of(const std::string& path, sockaddr_un& address) {
  address = {};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof address.sun_path) return false;
  std::memcpy(address.sun_path, path.data(), path.size());
  return true;
}

const sockaddr* generic(const sockaddr_un& address) { return reinterpret_cast<const sockaddr*>(&address); }

/// "4711.sock" gives 4711; 0: not the name of a socket.
pid_t pid_of(std::string_view name) {
  constexpr std::string_view suffix = ".sock";
  pid_t pid = 0;
  if (!name.ends_with(suffix)) return 0;
  name.remove_suffix(suffix.size());
  return detail::read_number(name, pid) == std::errc{} && pid > 0 ? pid : 0;
}

bool is_alive(pid_t pid) { return ::kill(pid, 0) == 0 || errno != ESRCH; }

/// The sockets in a folder, also those of ended processes.
std::vector<Instance> sockets_in(const std::string& folder) {
  std::vector<Instance> all;
  DIR* const directory = ::opendir(folder.c_str());
  if (directory == nullptr) return all;
  while (const dirent* entry = ::readdir(directory)) {
    if (const pid_t pid = pid_of(entry->d_name); pid != 0) all.push_back({pid, folder + "/" + entry->d_name});
  }
  ::closedir(directory);
  return all;
}

void close_pipe(uv_pipe_t* pipe) {
  uv_close(reinterpret_cast<uv_handle_t*>(pipe),
           [](uv_handle_t* closed) { delete reinterpret_cast<uv_pipe_t*>(closed); });
}

std::optional<ucred> peer_at(int fd) noexcept {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) return std::nullopt;
  return peer;
}

/// True if the peer is this user or root.
bool is_trusted(int fd) {
  const auto peer = peer_at(fd);
  return peer && (peer->uid == ::geteuid() || peer->uid == 0);
}

}  // namespace

struct ControlSocket::Client {
  ControlSocket* to;
  std::uint64_t number;
  MonotonicTime last_asked;  // or connected
  uv_pipe_t pipe{};
  uv_write_t write{};
  Timer timer = {};          // for the pause after an answer, and for the limit while an answer is not read
  std::string in = {};       // at most a line and the bytes read with it
  std::size_t searched = 0;  // how many bytes of `in` have no line end
  std::string out = {};      // an answer that is being sent
  std::size_t unread = 0;    // unread bytes when the limit began
  bool is_answered = false;  // an answer is being made
  bool has_ended = false;    // it sends no more
  int answered_after_end = 0;

  uv_stream_t* stream() noexcept { return reinterpret_cast<uv_stream_t*>(&pipe); }
  int fd() noexcept {
    uv_os_fd_t fd = -1;
    return uv_fileno(reinterpret_cast<uv_handle_t*>(&pipe), &fd) == 0 ? fd : -1;
  }
  /// Sends a last text before disconnecting, if that does not block.
  void tell(std::string text) {
    const uv_buf_t buffer = uv_buf_init(text.data(), static_cast<unsigned>(text.size()));
    uv_try_write(stream(), &buffer, 1);
  }
};

/// Makes one answer.
struct ControlSocket::Job final : detail::LaneJob {
  Job(ControlSocket& to, AnswerLane& lane, std::uint64_t client, Work work)
      : to_(to), lane_(lane), is_alive_(to.is_alive_), client_(client), work_(std::move(work)) {
    ++lane_.answers;
  }
  void run() noexcept override { text_ = work_(); }
  void done(Outcome outcome) override {
    if (!*is_alive_) return;
    --lane_.answers;
    // If the answer is late, the lane's thread still has the text.
    to_.answered(client_, outcome == Outcome::finished ? std::move(text_) : answer_line("error", "no answer in time"));
  }

 private:
  ControlSocket& to_;
  AnswerLane& lane_;
  std::shared_ptr<bool> is_alive_;
  std::uint64_t client_;
  Work work_;
  std::string text_;
};

ControlSocket::ControlSocket(Loop& loop, Answer answer, Gone gone)
    : loop_(loop), answer_(std::move(answer)), gone_(std::move(gone)) {
  for (int i = 0; i < answer_lanes; ++i) lanes_.emplace_back(loop.core(), client_patience);
  listen();
}

ControlSocket::~ControlSocket() {
  *is_alive_ = false;
  close_pipe(server_);  // which removes the path
  while (!clients_.empty()) {
    Client& client = *clients_.back();
    if (client.is_answered)
      client.tell("{\"ended\":\"the run has ended; its log says whether the command was done\"}\n");
    else if (client.out.empty())
      client.tell("{\"ended\":\"the run has ended\"}\n");
    drop(client);
  }
}

std::string ControlSocket::peer_of(std::uint64_t number) noexcept {
  Client* const client = find(number);
  const auto peer = client != nullptr ? peer_at(client->fd()) : std::nullopt;
  if (!peer) return "somebody";
  return "uid " + std::to_string(peer->uid) + ", pid " + std::to_string(peer->pid);
}

int ControlSocket::take_over(std::uint64_t number) noexcept {
  Client* const client = find(number);
  return client != nullptr ? ::fcntl(client->fd(), F_DUPFD_CLOEXEC, 0) : -1;
}

void ControlSocket::listen() {
  std::string why;
  for (const std::string& folder : folders()) {
    const auto failed = [&](const std::string& what) { why += (why.empty() ? "" : "; ") + folder + ": " + what; };
    if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
      failed(std::strerror(errno));
      continue;
    }
    if (!is_private(folder)) {
      failed("not a folder of mode 0700 of this user");
      continue;
    }
    for (const Instance& one : sockets_in(folder)) {
      if (one.pid == ::getpid() || !is_alive(one.pid)) ::unlink(one.path.c_str());
    }
    path_ = folder + "/" + std::to_string(::getpid()) + ".sock";
    sockaddr_un address;
    if (!address_of(path_, address)) {
      failed("the path is too long for a socket");
      continue;
    }
    server_ = new uv_pipe_t{};
    uv_pipe_init(loop_.uv(), server_, 0);
    server_->data = this;
    int status = uv_pipe_bind(server_, path_.c_str());
    // A posted function accepts one client in each turn, so that many clients do not hold the loop.
    if (status == 0)
      status = uv_listen(reinterpret_cast<uv_stream_t*>(server_), most_clients, [](uv_stream_t* server, int error) {
        auto& to = *static_cast<ControlSocket*>(server->data);
        if (error != 0) return;
        to.loop_.core().call_own("control socket", [&] {
          to.loop_.post([&to, is_alive = to.is_alive_] {
            if (*is_alive) to.accept();
          });
        });
      });
    if (status == 0) return;
    failed(uv_strerror(status));
    close_pipe(std::exchange(server_, nullptr));
  }
  throw SetupError({Errc::io_failed, "cannot open the control socket", "local socket", why,
                    "`rtdata top` does not see this instance; everything else works"});
}

void ControlSocket::accept() {
  auto* const client = new Client{this, last_number_ + 1, loop_.now()};
  client->pipe.data = client;
  uv_pipe_init(loop_.uv(), &client->pipe, 0);
  clients_.push_back(client);
  if (uv_accept(reinterpret_cast<uv_stream_t*>(server_), client->stream()) != 0 || !is_trusted(client->fd()))
    return drop(*client);
  if (clients_.size() > most_clients && !make_room()) {
    client->tell("{\"error\":\"too many clients, and all of them wait for their answers: ask again\"}\n");
    return drop(*client);
  }
  ++last_number_;
  client->timer = Timer(loop_, [this, number = client->number] { timed_out(number); });
  if (!answer_next(*client)) drop(*client);
}

/// Disconnects the client that has been silent for the longest time, of those (except the newest) that do not wait for
/// an answer. False: all wait for one.
bool ControlSocket::make_room() {
  Client* quietest = nullptr;
  for (Client* client : clients_) {
    if (client->is_answered || !client->out.empty() || client == clients_.back()) continue;
    if (quietest == nullptr || client->last_asked < quietest->last_asked) quietest = client;  // in order of connection
  }
  if (quietest == nullptr) return false;
  quietest->tell("{\"error\":\"too many clients; this one has asked nothing for the longest time\"}\n");
  drop(*quietest);
  return true;
}

ControlSocket::Client* ControlSocket::find(std::uint64_t number) noexcept {
  const auto found = std::find_if(clients_.begin(), clients_.end(),
                                  [&](const Client* client) { return client->number == number; });
  return found == clients_.end() ? nullptr : *found;
}

void ControlSocket::drop(Client& client) {
  std::erase(clients_, &client);
  client.to = nullptr;
  client.timer.close();
  uv_close(reinterpret_cast<uv_handle_t*>(&client.pipe),
           [](uv_handle_t* closed) { delete static_cast<Client*>(closed->data); });
  if (client.number <= last_number_) gone_(client.number);
}

void ControlSocket::received(Client& client, std::ptrdiff_t size) {
  if (size == 0) return;
  client.has_ended = size < 0;
  if (size > 0) client.in.append(buffer_.data(), static_cast<std::size_t>(size));
  if ((size < 0 && size != UV_EOF) || !answer_next(client)) drop(client);
}

bool ControlSocket::answer_next(Client& client) {
  const std::size_t end = client.in.find('\n', client.searched);
  if (end == std::string::npos) {
    client.searched = client.in.size();
    if (client.has_ended || client.in.size() > longest_line) return false;
    client.timer.stop();
    const auto allocate = [](uv_handle_t* of, std::size_t, uv_buf_t* buffer) {
      auto& room = static_cast<Client*>(of->data)->to->buffer_;
      *buffer = uv_buf_init(room.data(), static_cast<unsigned>(room.size()));
    };
    uv_read_start(client.stream(), allocate, [](uv_stream_t* of, ssize_t size, const uv_buf_t*) {
      auto& from = *static_cast<Client*>(of->data);
      from.to->loop_.core().call_own("control socket", [&] { from.to->received(from, size); });
    });
    return true;
  }
  if (end > longest_line || (client.has_ended && ++client.answered_after_end > most_after_end)) return false;
  const std::string line = client.in.substr(0, end);
  client.in.erase(0, end + 1);
  client.searched = 0;
  client.is_answered = true;
  client.last_asked = loop_.now();
  uv_read_stop(client.stream());
  Work work = answer_(client.number, line);
  if (!work) return false;
  AnswerLane& of = *std::min_element(lanes_.begin(), lanes_.end(),
                                     [](const AnswerLane& a, const AnswerLane& b) { return a.answers < b.answers; });
  const auto job = std::make_shared<Job>(*this, of, client.number, std::move(work));
  if (of.lane.submit(job)) return true;
  --of.answers;
  return false;
}

void ControlSocket::answered(std::uint64_t number, std::string text) {
  Client* const client = find(number);
  if (client == nullptr) return;
  client->is_answered = false;
  client->out = std::move(text) + "\n";
  client->write.data = client;
  const uv_buf_t buffer = uv_buf_init(client->out.data(), static_cast<unsigned>(client->out.size()));
  const int status = uv_write(&client->write, client->stream(), &buffer, 1, [](uv_write_t* write, int failed) {
    auto& to = *static_cast<Client*>(write->data);
    if (to.to != nullptr) to.to->loop_.core().call_own("control socket", [&] { to.to->sent(to, failed); });
  });
  if (status != 0) return drop(*client);
  client->unread = uv_stream_get_write_queue_size(client->stream());
  client->timer.start(client_patience);
}

void ControlSocket::sent(Client& client, int status) {
  if (status != 0) return drop(client);
  std::string().swap(client.out);
  client.timer.start(pause);
}

void ControlSocket::timed_out(std::uint64_t number) {
  Client* const client = find(number);
  if (client == nullptr) return;
  if (client->out.empty()) {
    if (!answer_next(*client)) drop(*client);
  } else if (const std::size_t left = uv_stream_get_write_queue_size(client->stream()); left < client->unread) {
    client->unread = left;
    client->timer.start(client_patience);
  } else {  // it has not read for too long
    drop(*client);
  }
}

std::vector<Instance> running_instances() {
  std::vector<Instance> all;
  for (const std::string& folder : folders_to_search()) {
    if (::geteuid() != 0 && !is_private(folder)) continue;
    for (Instance& one : sockets_in(folder)) {
      if (!is_alive(one.pid)) continue;
      const auto client = ControlClient::connect(one.path);
      if (client || client.error().code == make_error_code(Errc::busy)) all.push_back(std::move(one));
    }
  }
  std::sort(all.begin(), all.end(), [](const Instance& a, const Instance& b) { return a.pid < b.pid; });
  return all;
}

std::vector<std::string> closed_folders() {
  std::vector<std::string> all;
  for (std::string& folder : folders_to_search()) {
    if (::faccessat(AT_FDCWD, folder.c_str(), R_OK | X_OK, AT_EACCESS) != 0 && errno == EACCES)
      all.push_back(std::move(folder));
  }
  return all;
}

Result<ControlClient> ControlClient::connect(const std::string& path) {
  sockaddr_un address;
  if (!address_of(path, address))
    return Error{Errc::bad_argument, "cannot connect", path, "the path is too long", "use a shorter one"};
  ControlClient client(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  constexpr timeval patience{0, 500'000};  // for a full queue of other clients
  ::setsockopt(client.fd_.fd(), SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
  const bool is_connected = client.fd_.fd() >= 0 && ::connect(client.fd_.fd(), generic(address), sizeof address) == 0;
  if (!is_connected && errno == EAGAIN) {
    return Error{Errc::busy, "cannot connect", path, "too many clients wait for a connection",
                 "check whether the process is stopped"};
  }
  if (!is_connected) return system_error(errno, "cannot connect", path);
  if (!is_trusted(client.fd_.fd()) && ::geteuid() != 0)
    return Error{Errc::not_permitted, "cannot connect", path, "the instance belongs to another user", "ask that user"};
  return client;
}

Result<std::string> ControlClient::ask(std::string_view line, Duration at_most) {
  send(line);
  auto answer = receive(at_most);
  if (!answer) return std::move(answer).error();
  if (*answer) return std::move(**answer);
  return Error{Errc::timed_out, "no answer", "instance", "it did not answer in time",
               "check whether it is stopped, its loop is held, or the machine is busy"};
}

void ControlClient::send(std::string_view line) {
  out_.append(line).append("\n");
  send_more();
}

void ControlClient::send_more() {
  const ssize_t size = ::send(fd_.fd(), out_.data(), out_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  if (size > 0) out_.erase(0, static_cast<std::size_t>(size));
}

Result<std::optional<std::string>> ControlClient::receive(Duration at_most) {
  const auto until = std::chrono::steady_clock::now() + at_most;
  for (;;) {
    if (const std::size_t end = rest_.find('\n'); end != std::string::npos) {
      std::string answer = rest_.substr(0, end);
      rest_.erase(0, end + 1);
      return std::optional(std::move(answer));
    }
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - std::chrono::steady_clock::now()).count();
    pollfd waits{fd_.fd(), static_cast<short>(out_.empty() ? POLLIN : POLLIN | POLLOUT), 0};
    if (::poll(&waits, 1, static_cast<int>(std::max<std::int64_t>(left, 0))) <= 0) {
      if (left <= 0) return std::optional<std::string>{};
      continue;
    }
    if ((waits.revents & POLLOUT) != 0) send_more();
    if ((waits.revents & (POLLIN | POLLHUP | POLLERR)) != 0) {
      char buffer[16 * 1024];
      const ssize_t size = ::recv(fd_.fd(), buffer, sizeof buffer, MSG_DONTWAIT);
      if (size == 0 || (size < 0 && errno != EAGAIN && errno != EINTR)) {
        return Error{Errc::closed, "no answer", "instance",
                     "the instance has ended, or serves 8 later clients, which is the most",
                     "try again when it has fewer clients"};
      }
      if (size > 0) rest_.append(buffer, static_cast<std::size_t>(size));
      if (rest_.size() > longest_answer)
        return Error{Errc::bad_data, "no answer", "instance", "it sent 256 MiB without the end of a line",
                     "check what listens there"};
    }
  }
}

}  // namespace rtdata::app
