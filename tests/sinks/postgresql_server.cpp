#include "sinks/postgresql_server.hpp"

#include <fcntl.h>
#include <libpq-fe.h>
#include <pwd.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

namespace sinks {
namespace {

std::string& reason() {
  static std::string text;
  return text;
}

std::string find_programs() {
  std::string newest;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/usr/lib/postgresql", ignored)) {
    const std::string folder = entry.path().string() + "/bin";
    if (::access((folder + "/initdb").c_str(), X_OK) == 0 && folder > newest) newest = folder;
  }
  return newest;
}

struct Finish {
  void operator()(PGconn* connection) const noexcept { PQfinish(connection); }
};

}  // namespace

const std::string& PostgresqlServer::why_none() { return reason(); }

bool PostgresqlServer::is_there() {
  return !find_programs().empty() && (::getuid() != 0 || ::getpwnam("postgres") != nullptr);
}

PostgresqlServer* PostgresqlServer::shared() {
  static std::unique_ptr<PostgresqlServer> server;
  static bool has_tried = false;
  if (!has_tried) {
    has_tried = true;
    const std::string programs = find_programs();
    uid_t user = ::getuid();
    gid_t group = ::getgid();
    if (user == 0) {  // which the server refuses to run as
      const passwd* of = ::getpwnam("postgres");
      user = of != nullptr ? of->pw_uid : 0;
      group = of != nullptr ? of->pw_gid : 0;
    }
    if (programs.empty()) {
      reason() = "there is no PostgreSQL server (Debian: postgresql)";
    } else if (user == 0) {
      reason() = "there is no user postgres, and root may not run a server";
    } else {
      server.reset(new PostgresqlServer(programs, user, group));
    }
  }
  if (server != nullptr && !server->is_running()) server->start();
  return server.get();
}

PostgresqlServer::PostgresqlServer(std::string programs, uid_t user, gid_t group)
    : programs_(std::move(programs)), user_(user), group_(group) {
  // Not below TMPDIR: the name of a socket has 107 bytes at most.
  folder_ = "/tmp/rtdata-pg-XXXXXX";
  if (::mkdtemp(folder_.data()) == nullptr) throw std::runtime_error("no temporary directory");
  if (::getuid() == 0 && ::chown(folder_.c_str(), user_, group_) != 0) throw std::runtime_error("cannot chown");
  ::chmod(folder_.c_str(), 0755);
  int status = 0;
  const pid_t made = spawn({programs_ + "/initdb", "-D", folder_ + "/data", "-A", "trust", "-U", "rt", "-E", "UTF8",
                            "--locale=C.UTF-8", "--no-sync"});
  if (::waitpid(made, &status, 0) != made || status != 0)
    throw std::runtime_error("initdb failed: see " + folder_ + "/log");
  start();
}

PostgresqlServer::~PostgresqlServer() {
  stop(SIGQUIT);
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

pid_t PostgresqlServer::spawn(const std::vector<std::string>& arguments) const {
  std::vector<char*> argv;
  for (const std::string& one : arguments) argv.push_back(const_cast<char*>(one.c_str()));
  argv.push_back(nullptr);
  const std::string log = folder_ + "/log";
  const pid_t parent = ::getpid();
  const pid_t child = ::fork();
  if (child != 0) return child;
  if (::getuid() == 0 && (::setgid(group_) != 0 || ::setuid(user_) != 0)) ::_exit(1);
  ::prctl(PR_SET_PDEATHSIG, SIGQUIT);
  if (::getppid() != parent) ::_exit(1);
  const int out = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  ::dup2(out, 1);
  ::dup2(out, 2);
  if (::chdir("/") != 0) ::_exit(1);
  ::setenv("LC_ALL", "C", 1);
  ::execv(argv[0], argv.data());
  ::_exit(127);
}

void PostgresqlServer::start() { start({"listen_addresses="}); }

void PostgresqlServer::start_with_tls(const std::string& port, const std::string& certificate, const std::string& key) {
  stop(SIGINT);
  const std::string own = folder_ + "/server.key";  // which the server wants to be of its user alone
  std::filesystem::copy_file(key, own, std::filesystem::copy_options::overwrite_existing);
  std::filesystem::permissions(own, std::filesystem::perms::owner_read);
  std::filesystem::copy_file(certificate, folder_ + "/server.pem", std::filesystem::copy_options::overwrite_existing);
  if (::getuid() == 0 &&
      (::chown(own.c_str(), user_, group_) != 0 || ::chown((folder_ + "/server.pem").c_str(), user_, group_) != 0))
    throw std::runtime_error("cannot chown");
  start({"listen_addresses=127.0.0.1", "port=" + port, "ssl=on", "ssl_cert_file=" + folder_ + "/server.pem",
         "ssl_key_file=" + own});
}

void PostgresqlServer::start(const std::vector<std::string>& settings) {
  if (is_running()) return;
  std::vector<std::string> arguments{programs_ + "/postgres", "-D", folder_ + "/data", "-k", folder_};
  port_ = "5432";
  for (const std::string& setting : settings) {
    if (setting.starts_with("port=")) port_ = setting.substr(5);
    arguments.insert(arguments.end(), {"-c", setting});
  }
  for (const char* setting : {"fsync=off", "shared_buffers=16MB"}) arguments.insert(arguments.end(), {"-c", setting});
  pid_ = spawn(arguments);
  for (int i = 0; i < 3000; ++i) {
    if (PQping(url("postgres").c_str()) == PQPING_OK) return;
    if (::waitpid(pid_, nullptr, WNOHANG) == pid_) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));  // it tells nobody when it is ready
  }
  pid_ = -1;
  throw std::runtime_error("the server does not start: see " + folder_ + "/log");
}

void PostgresqlServer::stop(int signal) {
  if (!is_running()) return;
  ::kill(pid_, SIGCONT);
  ::kill(pid_, signal);
  ::waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

void PostgresqlServer::freeze() {
  ::kill(pid_, SIGSTOP);
  // Its servers of each connection too.
  for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(pid_) + "/task")) {
    std::FILE* file = std::fopen((entry.path().string() + "/children").c_str(), "r");
    if (file == nullptr) continue;
    for (int child = 0; std::fscanf(file, "%d", &child) == 1;) ::kill(child, SIGSTOP);
    std::fclose(file);
  }
}

void PostgresqlServer::thaw() {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(pid_) + "/task")) {
    std::FILE* file = std::fopen((entry.path().string() + "/children").c_str(), "r");
    if (file == nullptr) continue;
    for (int child = 0; std::fscanf(file, "%d", &child) == 1;) ::kill(child, SIGCONT);
    std::fclose(file);
  }
  ::kill(pid_, SIGCONT);
}

std::string PostgresqlServer::url(const std::string& database) const {
  return "postgresql://rt@/" + database + "?host=" + folder_ + "&port=" + port_;
}

std::string PostgresqlServer::make_database(const std::string& options) {
  const std::string name = "test" + std::to_string(++databases_);
  sql("postgres", "CREATE DATABASE " + name + " " + options);
  return name;
}

std::string PostgresqlServer::sql(const std::string& database, const std::string& statements) const {
  const std::unique_ptr<PGconn, Finish> connection(PQconnectdb(url(database).c_str()));
  PQsetNoticeProcessor(
      connection.get(), [](void*, const char*) {}, nullptr);
  const std::unique_ptr<PGresult, decltype(&PQclear)> result(PQexec(connection.get(), statements.c_str()), PQclear);
  const ExecStatusType status = PQresultStatus(result.get());
  if (status != PGRES_COMMAND_OK && status != PGRES_TUPLES_OK)
    throw std::runtime_error(PQerrorMessage(connection.get()));
  std::string text;
  for (int row = 0; row < PQntuples(result.get()); ++row)
    text += (row == 0 ? "" : "\n") + std::string(PQgetvalue(result.get(), row, 0));
  return text;
}

}  // namespace sinks
