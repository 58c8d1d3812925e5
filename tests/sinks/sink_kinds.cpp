#include "sinks/sink_kinds.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "recording/database.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sinks/console.hpp"
#include "rtdata/sinks/file.hpp"
#include "rtdata/sinks/tcp.hpp"

namespace sinks {
namespace {

using namespace rtdata;

class FileStore final : public Store {
 public:
  explicit FileStore(std::string format) : format_(std::move(format)) {}
  Sink make(Loop& loop, SinkConfig config) override {
    return FileSink(loop, {.path = directory_ / "run-{topic}", .format = format_, .sink = std::move(config)});
  }
  std::vector<Row> rows() override {
    std::vector<Row> all;
    const auto codec = CodecRegistry::standard().make(format_ == "jsonl" ? "json" : format_).or_throw();
    for (const auto& entry : std::filesystem::directory_iterator(directory_.path)) {
      std::string topic = entry.path().filename().string().substr(4);
      std::replace(topic.begin(), topic.end(), '-', '/');
      const std::string text = content(entry.path().string());
      std::span<const std::byte> left = std::as_bytes(std::span(text));
      if (!codec->header(*description_of<Number>()).empty() && !left.empty())
        left = left.subspan(codec->first_event(left));
      // A row's number is not in raw bytes: counted.
      for (std::uint64_t number = 1; !left.empty(); ++number) {
        const std::size_t size = codec->first_event(left);
        const auto event = decode<Number>(*codec, left.first(size)).or_throw();
        all.push_back({topic, event.sequence.value_or(number), event.data.value});
        left = left.subspan(size);
      }
    }
    return all;
  }

 private:
  Directory directory_;
  std::string format_;
};

class ConsoleStore final : public Store {
 public:
  ConsoleStore() {
    if (::pipe2(ends_, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    ::fcntl(ends_[0], F_SETFL, O_NONBLOCK);
    ::fcntl(ends_[1], F_SETPIPE_SZ, 1 << 20);
  }
  ~ConsoleStore() override {
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  Sink make(Loop& loop, SinkConfig config) override {
    return ConsoleSink(loop, {.descriptor = ends_[1], .sink = std::move(config)});
  }
  std::vector<Row> rows() override {
    char buffer[65536];
    for (ssize_t got; (got = ::read(ends_[0], buffer, sizeof buffer)) > 0;)
      text_.append(buffer, static_cast<std::size_t>(got));
    std::vector<Row> all;
    std::istringstream lines(text_);
    for (std::string line; std::getline(lines, line);) {
      std::istringstream words(line);
      std::string time, topic, origin, number, value;
      words >> time >> topic >> origin >> number >> value;
      all.push_back({topic, std::stoull(number.substr(1)), std::stod(value.substr(std::strlen("value=")))});
    }
    return all;
  }

 private:
  int ends_[2];
  std::string text_;
};

class SqliteStore final : public Store {
 public:
  Sink make(Loop& loop, SinkConfig config) override {
    return SqliteSink(loop, {.path = directory_ / "run.db", .sink = std::move(config)});
  }
  std::vector<Row> rows() override {
    std::vector<Row> all;
    const auto database = sqlite::Database::open(directory_ / "run.db", sqlite::Database::Mode::read);
    auto topics = database.prepare("SELECT topic, table_name FROM rtdata_topic");
    while (topics.step()) {
      auto rows = database.prepare("SELECT sequence, value FROM " + sqlite::quoted(topics.text(1)) + " ORDER BY rowid");
      while (rows.step()) {
        all.push_back({std::string(topics.text(0)), static_cast<std::uint64_t>(rows.integer(0)), rows.real(1)});
      }
    }
    return all;
  }

 private:
  Directory directory_;
};

class ScriptedStore final : public Store {
 public:
  ScriptedStore(Duration lane_duration, int fail_every) : lane_duration_(lane_duration) {
    script_->fail_every = fail_every;
  }
  Sink make(Loop& loop, SinkConfig config) override {
    loop.script_lane_duration(lane_duration_);
    return Sink(loop, std::move(config), std::make_unique<ScriptedWriter>(script_));
  }
  std::vector<Row> rows() override { return script_->rows; }

 private:
  std::shared_ptr<ScriptedWriter::Script> script_ = std::make_shared<ScriptedWriter::Script>();
  Duration lane_duration_;
};

/// A server that has a connection for each sink, and reads when it is asked for its rows.
class TcpStore final : public Store {
 public:
  TcpStore() {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (::bind(listener_, reinterpret_cast<sockaddr*>(&address), size) != 0 || ::listen(listener_, 16) != 0 ||
        ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size) != 0)
      throw std::runtime_error("no server");
    port_ = ntohs(address.sin_port);
  }
  ~TcpStore() override {
    ::close(listener_);
    for (const auto& [connection, text] : connections_) ::close(connection);
  }
  Sink make(Loop& loop, SinkConfig config) override {
    return TcpSink(loop, {.host = "127.0.0.1", .port = port_, .sink = std::move(config)});
  }
  std::vector<Row> rows() override {
    for (int one; (one = ::accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC)) >= 0;)
      connections_.emplace_back(one, "");
    const auto codec = make_json_codec();
    std::vector<Row> all;
    for (auto& [connection, text] : connections_) {
      char buffer[65536];
      for (ssize_t got; (got = ::read(connection, buffer, sizeof buffer)) > 0;)
        text.append(buffer, static_cast<std::size_t>(got));
      std::istringstream lines(text);
      for (std::string line; std::getline(lines, line);) {
        const auto event = codec->decode(std::as_bytes(std::span(line)), *description_of<Number>()).or_throw();
        Number number;
        std::memcpy(&number, event.payload.data(), sizeof number);
        all.push_back({event.topic, event.sequence.value(), number.value});
      }
    }
    return all;
  }

 private:
  int listener_ = -1;
  std::uint16_t port_ = 0;
  std::vector<std::pair<int, std::string>> connections_;
};

std::vector<SinkKind>& added_kinds() {
  static std::vector<SinkKind> kinds;
  return kinds;
}

}  // namespace

bool add_sink_kind(SinkKind kind) {
  added_kinds().push_back(std::move(kind));
  return true;
}

const std::vector<SinkKind>& sink_kinds() {
  using namespace std::chrono_literals;
  static std::vector<SinkKind> kinds = {
      {"file, JSON lines", [] { return std::make_unique<FileStore>("jsonl"); }},
      {"file, CSV", [] { return std::make_unique<FileStore>("csv"); }},
      {"file, CBOR", [] { return std::make_unique<FileStore>("cbor"); }},
      {"file, lines of InfluxDB", [] { return std::make_unique<FileStore>("influx"); }},
      {"file, raw bytes", [] { return std::make_unique<FileStore>("raw"); }},
      {"SQLite", [] { return std::make_unique<SqliteStore>(); }},
      {"console", [] { return std::make_unique<ConsoleStore>(); }},
      {"TCP", [] { return std::make_unique<TcpStore>(); }, true},
      {"slow writer", [] { return std::make_unique<ScriptedStore>(300ms, 0); }},
      {"failing writer", [] { return std::make_unique<ScriptedStore>(0ms, 3); }},
  };
  for (SinkKind& kind : added_kinds()) kinds.push_back(std::move(kind));
  added_kinds().clear();
  return kinds;
}

Directory::Directory() {
  const char* base = std::getenv("TMPDIR");
  path = std::string(base != nullptr ? base : "/tmp") + "/rtdata-test-XXXXXX";
  if (::mkdtemp(path.data()) == nullptr) throw std::runtime_error("no temporary directory");
}

Directory::~Directory() {
  std::error_code ignored;
  std::filesystem::remove_all(path, ignored);
}

std::string content(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

rtdata::Result<void> ScriptedWriter::open() {
  ++script_->opens;
  return {};
}

rtdata::Result<void> ScriptedWriter::write(rtdata::Batch& batch) {
  Script& script = *script_;
  if (script.before_write) script.before_write();
  ++script.writes;
  const bool fails = script.failures > 0 || (script.fail_every > 0 && script.writes % script.fail_every == 0);
  if (script.ends) return rtdata::Error{rtdata::Errc::closed, "it has ended", "script", "", ""};
  for (const rtdata::Record& record : batch) {
    double value = 0;
    std::memcpy(&value, record.payload.data(), sizeof value);
    if (value == script.refused_value) {
      batch.refuse(record, {rtdata::Errc::does_not_fit, "refused by the script", "", "", ""});
    } else if (!fails) {
      script.rows.push_back({record.info->topic, record.header.sequence, value});
    }
  }
  if (fails) {
    if (script.failures > 0) --script.failures;
    if (script.throws) throw std::runtime_error("thrown by the script");
    return rtdata::Error{rtdata::Errc::io_failed, "failed by the script", "", "", ""};
  }
  if (batch.size() > 0) script.batches.push_back(batch.size());
  if (batch.account() != nullptr) {
    ++script.accounts;
    script.has_last_account = script.has_last_account || batch.account()->is_last;
  }
  return {};
}

rtdata::Result<void> ScriptedWriter::close() {
  ++script_->closes;
  return {};
}

rtdata::Result<void> ScriptedWriter::add_topic(std::uint32_t, std::string_view topic, const rtdata::Description&) {
  return script_->on_topic ? script_->on_topic(topic) : rtdata::Result<void>{};
}

}  // namespace sinks
