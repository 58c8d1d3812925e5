// A small RAII wrapper over the sqlite3 C API. Not thread-safe: one user at a time. Errors are thrown as SetupError; a
// call from outside (a writer's, Recording's, verify, a replay's) returns them.
#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata::sqlite {

class Statement {
 public:
  Statement() = default;
  explicit Statement(sqlite3_stmt* statement) : statement_(statement) {}
  explicit operator bool() const noexcept { return statement_ != nullptr; }
  sqlite3_stmt* raw() const noexcept { return statement_.get(); }

  Statement& bind(int index, std::int64_t value) noexcept;
  Statement& bind(int index, double value) noexcept;
  /// Escapes bytes that are not UTF-8. Does not copy: the text must live until the statement has run.
  Statement& bind(int index, std::string_view value);
  Statement& bind_null(int index) noexcept;
  /// Binds the parameters from the first on; an empty optional as NULL.
  template <class... Values>
  Statement& bind_all(const Values&... values) {
    int index = 0;
    (bind_any(++index, values), ...);
    return *this;
  }

  /// Runs up to the next row: true when there is one. One that fails is reset.
  bool step();
  /// Runs to the end and resets.
  void run();
  /// Runs to the end: the first column of each row.
  std::vector<std::string> texts();
  void reset() noexcept;

  std::int64_t integer(int column) const noexcept;
  double real(int column) const noexcept;
  /// Valid until the next step.
  std::string_view text(int column) const noexcept;
  bool is_null(int column) const noexcept;

 private:
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const noexcept { sqlite3_finalize(statement); }
  };
  template <class Value>
  void bind_any(int index, const Value& value) {
    if constexpr (std::is_integral_v<Value>)
      bind(index, static_cast<std::int64_t>(value));
    else
      bind(index, value);
  }
  template <class Value>
  void bind_any(int index, const std::optional<Value>& value) {
    value ? bind_any(index, *value) : static_cast<void>(bind_null(index));
  }
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
};

class Database {
 public:
  /// `read_at_rest`: the file does not change, so no lock is needed; for read-only media.
  enum class Mode { read, read_at_rest, write };
  Database() = default;
  /// Opens the file; write mode makes a missing one. Waits up to two seconds for other programs' locks. `permissions`:
  /// of a new file, minus the umask.
  static Database open(const std::string& path, Mode mode, mode_t permissions = 0640);

  explicit operator bool() const noexcept { return database_ != nullptr; }
  Statement prepare(std::string_view sql) const;
  /// One or more statements without results.
  void execute(const std::string& sql) const;
  /// The first column of the first row; 0 when there is none.
  std::int64_t integer(std::string_view sql) const;
  std::int64_t last_rowid() const noexcept { return sqlite3_last_insert_rowid(database_.get()); }
  sqlite3* raw() const noexcept { return database_.get(); }
  const std::string& path() const noexcept { return path_; }

 private:
  struct Close {
    void operator()(sqlite3* database) const noexcept { sqlite3_close_v2(database); }
  };
  std::unique_ptr<sqlite3, Close> database_;
  std::string path_;
};

/// The columns of a table.
std::vector<std::string> columns_of(const Database& database, std::string_view table);

/// The error that a call on this database has just returned.
Error error_of(sqlite3* database, std::string_view doing);
/// quoted(name): "name" with quotes doubled, for use in SQL. An object, since arguments of namespace std do not bring
/// in std::quoted beside an object as they do beside a function.
struct Quoted {
  std::string operator()(std::string_view name) const;
};
inline constexpr Quoted quoted{};

}  // namespace rtdata::sqlite
