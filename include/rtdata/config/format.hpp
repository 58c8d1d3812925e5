/// load_config: reads configuration files; ConfigFormat: adds formats.
///
/// `load_config` reads a file in the format of its extension (JSON with comments is included). It throws nothing: every
/// mistake that it finds is in the document. Extensions: ".json", ".jsonc", or none.
///
///     rtdata::ConfigDocument document = rtdata::load_config("bench.json");
///     check(document.root, document.problems);   // mistakes that you find
///     if (!document.problems.empty()) { std::cerr << document.report(); return 2; }
///     use(document.root);
///
/// A format of your own implements `ConfigFormat` with the help of `ConfigBuilder`, and is added to a `ConfigFormats`
/// that is given to `load_config`. There is no global list.
///
/// `with_member` and `without_member` change one member of an object in the text of JSON; comments, order and layout
/// stay:
///
///     text = rtdata::with_member(document, document.root.at("sensors[0]"), "rate", rtdata::ConfigItem::of("50 Hz"));
///
/// Limits: a file of 64 MiB, 64 levels of nesting. Text is UTF-8, with or without a byte order mark.
/// Values; a ConfigFormats is its holder's; any thread. `load_config` blocks on the file system: call it before a loop
/// runs, or on a lane.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/config_value.hpp"

namespace rtdata {

/// A configuration as it was read: its text, its tree, and what is wrong with it.
struct ConfigDocument {
  std::string file;  ///< as it was asked for
  std::string text;  ///< as it is in the file
  ConfigItem root;   ///< null when the file could not be read or has a syntax error
  Problems problems;

  bool good() const noexcept { return problems.empty(); }
  /// The root; throws ConfigError when there are problems. For small programs.
  ConfigItem or_throw() const;
  /// The line of a problem of this file, and below it a '^' under its column; long lines are cut. Empty when it has
  /// none.
  std::string excerpt(const Problem& problem) const;
  /// Every problem in the order of the file, each with its excerpt.
  std::string report() const { return report(problems); }
  /// The same for other problems, such as those of a plan, each after `prefix`. The time is linear in the size of the
  /// file plus the number of problems.
  std::string report(const Problems& others, std::string_view prefix = {}) const;
};

/// A file format. Stateless; used by any thread.
class ConfigFormat {
 public:
  virtual ~ConfigFormat() = default;
  /// "JSON"
  virtual std::string_view name() const = 0;
  /// {".json"}; an empty one means files without extension.
  virtual std::vector<std::string> extensions() const = 0;
  /// Reads `text`, which is valid UTF-8, not empty, and has no NUL and no byte order mark. Adds each mistake to
  /// `problems`, with its place in `file`.
  virtual ConfigItem read(std::string_view text, const std::string& file, Problems& problems) const = 0;
};

/// The formats that can be read. Holds JSON from the start.
class ConfigFormats {
 public:
  ConfigFormats();
  /// Later ones win over earlier ones with the same extension.
  void add(std::unique_ptr<ConfigFormat> format);
  /// The format of this file name; null when none has its extension. Valid as long as this object.
  const ConfigFormat* find(std::string_view file) const;
  /// The extensions of all formats, each once.
  std::vector<std::string> extensions() const;

 private:
  std::vector<std::unique_ptr<ConfigFormat>> formats_;
};

/// Reads a file.
ConfigDocument load_config(const std::string& file);
ConfigDocument load_config(const std::string& file, const ConfigFormats& formats);
/// Reads a text. Places have `name` as the file name, and its extension chooses the format.
ConfigDocument parse_config(std::string_view text, const std::string& name = "configuration.json");
ConfigDocument parse_config(std::string_view text, const std::string& name, const ConfigFormats& formats);

/// Builds the tree of a file from its start to its end; for formats. It finds duplicate keys and too deep nesting.
///
///     ConfigBuilder builder(file, problems);
///     builder.begin_object({1, 1});
///     builder.key("rate", {2, 1});
///     builder.string("50 Hz", {2, 8});
///     builder.end();
///     return builder.finish();
///
/// Debug builds assert that the calls form a tree (no value without key in an object, no second root).
class ConfigBuilder {
 public:
  /// Counted from 1, columns in characters.
  struct Position {
    std::size_t line = 0;
    std::size_t column = 0;
  };

  /// `problems` must outlive the builder.
  ConfigBuilder(const std::string& file, Problems& problems);
  ~ConfigBuilder();
  ConfigBuilder(const ConfigBuilder&) = delete;
  ConfigBuilder& operator=(const ConfigBuilder&) = delete;

  /// False when the nesting is too deep: a problem is added, and reading should stop.
  bool begin_object(Position position);
  bool begin_array(Position position);
  /// The key of the next value, in an object.
  void key(std::string_view key, Position position);
  /// The innermost object or array ends.
  void end();

  void null(Position position);
  void boolean(bool value, Position position);
  void integer(std::int64_t value, Position position);
  void integer(std::uint64_t value, Position position);
  /// `literal`: the number as it is written in JSON, kept for writing it again; empty for none.
  void number(double value, std::string_view literal, Position position);
  void string(std::string_view value, Position position);

  /// How many objects and arrays are open, and where the innermost one began.
  std::size_t depth() const noexcept;
  Position innermost() const noexcept;
  /// Path of the innermost open object or array.
  std::string path() const;
  /// The tree built so far; closes open objects and arrays.
  ConfigItem finish();

 private:
  struct Frame;
  bool begin(ConfigItem item, Position position);
  void add(ConfigItem item, Position position);
  void attach(ConfigItem item);
  void locate(ConfigItem& item, Position position) const;

  std::shared_ptr<const std::string> file_;
  Problems& problems_;
  std::vector<Frame> frames_;
  std::string key_;
  Position key_position_;
  ConfigItem root_;
};

/// The text of a document of JSON without problems, with this value for the key of an object in its root: in place of
/// the value before, or behind the last member. Read the result again before the next change: places move.
std::string with_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key,
                        const ConfigItem& value);
/// The text without this key; the same text if the object has no such key.
std::string without_member(const ConfigDocument& document, const ConfigItem& object, std::string_view key);

}  // namespace rtdata
