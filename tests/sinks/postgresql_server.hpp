/// A PostgreSQL server of the tests' own: on a socket in a folder of its own, without a port, gone with the process.
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>
#include <vector>

#include "sinks/sink_kinds.hpp"

namespace sinks {

class PostgresqlServer {
 public:
  /// The one that all tests share; null when there is none: `why_none` has the reason. It runs.
  static PostgresqlServer* shared();
  /// Whether there is one, without starting it.
  static bool is_there();
  static const std::string& why_none();

  ~PostgresqlServer();
  PostgresqlServer(const PostgresqlServer&) = delete;
  PostgresqlServer& operator=(const PostgresqlServer&) = delete;

  void start();
  /// Anew, with TLS at a port of this machine until the next start: with the certificate and the key of these files.
  void start_with_tls(const std::string& port, const std::string& certificate, const std::string& key);
  /// By a signal: SIGQUIT at once, as a crash; SIGINT in order.
  void stop(int signal);
  bool is_running() const noexcept { return pid_ > 0; }
  /// Stands still, or goes on.
  void freeze();
  void thaw();

  /// A new empty database.
  std::string make_database(const std::string& options = "");
  const std::string& folder() const noexcept { return folder_; }
  std::string url(const std::string& database) const;
  /// The first column of the rows, a line each. Throws with the server's message.
  std::string sql(const std::string& database, const std::string& statements) const;
  std::int64_t number(const std::string& database, const std::string& query) const {
    return std::stoll(sql(database, query));
  }
  /// Who runs it.
  uid_t user() const noexcept { return user_; }

 private:
  PostgresqlServer(std::string programs, uid_t user, gid_t group);
  void start(const std::vector<std::string>& settings);
  pid_t spawn(const std::vector<std::string>& arguments) const;

  std::string programs_, folder_;
  uid_t user_;
  gid_t group_;
  pid_t pid_ = -1;
  std::string port_ = "5432";  // that its socket is named after
  int databases_ = 0;
};

}  // namespace sinks

/// Ends the test, with a reason, when there is no server.
#define SERVER_OR_SKIP(name)                                                        \
  sinks::PostgresqlServer* const shared_server = sinks::PostgresqlServer::shared(); \
  if (shared_server == nullptr) {                                                   \
    MESSAGE("skipped: " << sinks::PostgresqlServer::why_none());                    \
    return;                                                                         \
  }                                                                                 \
  sinks::PostgresqlServer& name = *shared_server
