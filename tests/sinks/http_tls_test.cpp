// The HTTP sink by HTTPS: certificates of every kind, and nginx with HTTP/2, limits and kept connections.
#ifdef RTDATA_WITH_HTTP
#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <fstream>

#include "has.hpp"
#include "listening.hpp"
#include "sinks/certificates.hpp"
#include "sinks/http_bench.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using Json = HttpServer::Json;

namespace {

const std::string nginx = "/usr/sbin/nginx";

using rtdata::test::has;

/// A port of this machine that is free now.
std::string free_port() {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  const bool is_bound = ::bind(fd, reinterpret_cast<const sockaddr*>(&address), size) == 0 &&
                        ::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) == 0;
  ::close(fd);
  REQUIRE(is_bound);
  return std::to_string(ntohs(address.sin_port));
}

/// nginx in front of another server.
class Nginx {
 public:
  Nginx(const HttpServer& behind, const std::string& limit) : port(free_port()), plain_port(free_port()) {
    const Certificates& certificates = Certificates::all();
    folder_.write("nginx.conf",
                  "daemon off; pid nginx.pid; error_log errors; worker_processes 1; user root;\n"
                  "events { worker_connections 64; }\n"
                  "http {\n"
                  "  log_format short '$server_protocol $connection $status';\n"
                  "  access_log access short;\n"
                  "  client_body_temp_path body; proxy_temp_path proxy; fastcgi_temp_path fastcgi;\n"
                  "  uwsgi_temp_path uwsgi; scgi_temp_path scgi;\n"
                  "  server {\n"
                  "    listen 127.0.0.1:" +
                      port +
                      " ssl http2;\n"
                      "    listen 127.0.0.1:" +
                      plain_port +
                      ";\n"
                      "    ssl_certificate " +
                      certificates / "right.pem" +
                      ";\n"
                      "    ssl_certificate_key " +
                      certificates / "right.key" +
                      ";\n"
                      "    client_max_body_size " +
                      limit +
                      ";\n"
                      "    location / { proxy_pass http://127.0.0.1:" +
                      behind.port() +
                      "; }\n"
                      "  }\n"
                      "}\n");
    start();
  }
  void start() {
    process_.emplace(folder_, nginx,
                     std::vector<std::string>{"-p", folder_.path(), "-c", folder_.path() + "/nginx.conf"});
    REQUIRE_MESSAGE(rtdata::test::comes_to_listen(static_cast<std::uint16_t>(std::stoi(port))), folder_.read("errors"));
  }
  void stop() {
    process_->signal(SIGTERM);
    process_->end();
    process_.reset();
  }
  ~Nginx() {
    if (process_) stop();
  }
  /// A line a request: protocol, connection, status.
  std::vector<std::string> accesses() const {
    std::vector<std::string> all;
    std::istringstream lines(folder_.read("access"));
    for (std::string line; std::getline(lines, line);) all.push_back(line);
    return all;
  }
  std::string url() const { return "https://localhost:" + port + "/in"; }

  const std::string port, plain_port;

 private:
  rtdata::test::Folder folder_;
  std::optional<rtdata::test::Process> process_;
};

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("US-32 HTTPS: the server's certificate is checked, and what is wrong with it is said") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  const Certificates& certificates = Certificates::all();
  const struct {
    const char* certificate;
    bool knows_authority;
    const char* reason;
  } cases[] = {{"right", true, ""},
               {"right", false, "tls.ca_file"},
               {"self", true, "tls.ca_file"},
               {"expired", true, "renew the server's certificate"},
               {"other", true, "use the name of the server's certificate"}};
  for (const auto& one : cases) {
    CAPTURE(one.certificate);
    CAPTURE(one.knows_authority);
    HttpServer server(certificates.of(one.certificate));
    HttpConfig config{.server = {.url = "https://127.0.0.1:" + server.port() + "/in"}};
    if (one.knows_authority) config.server.tls.ca_file = certificates / "ca.pem";
    HttpBench bench(config);
    bench.publish(10);
    const bool is_right = std::string(one.reason).empty();
    CHECK_MESSAGE((is_right ? bench.is_all_sent() : bench.is_faulted()), bench.said());
    CHECK_MESSAGE(has(bench.reason(), one.reason), bench.reason());
    CHECK(server.events().size() == (is_right ? 10 : 0));
    if (is_right) continue;
    config.server.tls = {.verify = false};
    HttpBench trusting(config);
    trusting.publish(3);
    CHECK(trusting.is_all_sent());
  }
}

TEST_CASE("US-32 HTTPS: this machine proves who it is where the server asks for it") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  const Certificates& certificates = Certificates::all();
  std::vector<std::string> asking = certificates.of("right");
  asking.push_back(certificates / "ca.pem");
  HttpServer server(asking);
  HttpConfig config{
      .server = {.url = "https://localhost:" + server.port() + "/in", .tls = {.ca_file = certificates / "ca.pem"}}};
  {
    HttpBench bench(config);
    bench.publish(1);
    CHECK_MESSAGE(bench.is_faulted(), bench.said());
    CHECK(server.events().empty());
  }
  config.server.tls.certificate = certificates / "client.pem";
  for (const char* key : {"client.key", "locked.key"}) {
    config.server.tls.key = certificates / key;
    config.server.tls.key_password = std::string(key) == "locked.key" ? "key-s3cret" : "";
    HttpBench bench(config);
    bench.publish(4);
    CHECK_MESSAGE(bench.is_all_sent(), bench.said());
  }
  for (const char* password : {"", "wrong-s3cret"}) {  // nobody is asked for it at the terminal
    config.server.tls.key_password = password;
    HttpBench bench(config);
    bench.publish(1);
    CHECK(bench.is_faulted());
    CHECK_MESSAGE(has(bench.reason(), "tls.key_password"), bench.reason());
    CHECK(!has(bench.said(), "s3cret"));
  }
}

TEST_CASE("US-32 HTTPS at a port that speaks none, and HTTP at one of HTTPS") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  HttpServer plain;
  HttpServer encrypted(Certificates::all().of("right"));
  for (const std::string& url : {"https://127.0.0.1:" + plain.port(), "http://127.0.0.1:" + encrypted.port()}) {
    CAPTURE(url);
    HttpBench bench({.server = {.url = url}, .sending = {.timeout = 2s}});
    bench.publish(1);
    (void)wait_for(bench.loop, [&, begin = std::chrono::steady_clock::now()] {
      return bench.sink.health() == Health::faulted || std::chrono::steady_clock::now() - begin > 1s;
    });
    bench.loop.advance(3s);
    CHECK(bench.is_faulted());
    CHECK(bench.sink.counts().queued == 1);
  }
}

TEST_CASE("US-32 nginx: HTTP/2 on one connection, its limit on a request, and a restart") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  NEEDS_PROGRAM(nginx);
  HttpServer server;
  Nginx front(server, "2k");
  HttpBench bench({.server = {.url = front.url(), .tls = {.ca_file = Certificates::all() / "ca.pem"}},
                   .sending = {.window = 4, .parcel_rows = 8}});
  bench.publish(200);
  REQUIRE_MESSAGE(bench.is_all_sent(), bench.said());
  std::set<std::string> connections, statuses;
  for (const std::string& line : front.accesses()) {
    std::istringstream words(line);
    std::string protocol, connection, status;
    words >> protocol >> connection >> status;
    CHECK(protocol == "HTTP/2.0");
    connections.insert(connection);
    statuses.insert(status);
  }
  CHECK(connections.size() == 1);
  CHECK(statuses == std::set<std::string>{"200"});
  CHECK(server.sequences() == bench.all());

  front.stop();
  bench.publish(50);
  CHECK(bench.is_faulted());
  front.start();
  bench.loop.advance(11s);
  CHECK(bench.is_all_sent());
  CHECK(server.sequences() == bench.all());
  CHECK(server.events().size() == 250);
}

TEST_CASE("US-32 nginx: what is too large for it arrives in halves; a server behind it that is away is waited for") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  NEEDS_PROGRAM(nginx);
  HttpServer server;
  Nginx front(server, "1k");
  for (const HttpVersion version : {HttpVersion::automatic, HttpVersion::one}) {
    server.forget();
    HttpBench bench(
        {.server = {.url = front.url(), .http_version = version, .tls = {.ca_file = Certificates::all() / "ca.pem"}},
         .sending = {.window = 2, .parcel_rows = 64}});
    bench.publish(128);
    CHECK_MESSAGE(bench.is_all_sent(), bench.said());
    CHECK(server.sequences() == bench.all());
    CHECK(server.events().size() == 128);
  }
  bool is_limited = false;
  for (const std::string& line : front.accesses()) is_limited = is_limited || has(line, " 413");
  CHECK(is_limited);

  server.kill();
  HttpBench bench({.server = {.url = "http://localhost:" + front.plain_port + "/in"}});
  bench.publish(3);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.reason(), "502 Bad Gateway"), bench.reason());
  server.start();
  bench.loop.advance(11s);
  CHECK(bench.is_all_sent());
}

TEST_SUITE_END();
#endif
