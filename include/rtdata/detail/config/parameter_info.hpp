/// ParameterInfo: the parameters of a component at run time, for listings, documentation and editors.
///
/// Made by `parameters_of<Config>()` (read.hpp) from the declaration; see parameter.hpp. Values; any thread.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/io/chip.hpp"

namespace rtdata {

struct ParameterInfo;

/// What a parameter holds.
struct ParameterType {
  enum class Kind {
    any,  ///< not known here
    boolean,
    integer,
    number,
    character,
    string,
    duration,
    rate,
    text_or_integer,  ///< a text that `pattern` describes, or a whole number
    choice,           ///< one of `choices`
    list,             ///< of `element`
    map,              ///< any keys, with `element` as values
    object,           ///< of `members`
  };
  Kind kind = Kind::any;
  bool nullable = false;              ///< null is a value (std::optional)
  std::size_t length = 0;             ///< of a list; 0: any
  std::optional<double> least, most;  ///< numbers as they are, durations in ns, rates in Hz
  bool not_zero = false;
  bool not_empty = false;          ///< a text
  bool may_be_negative = false;    ///< a duration
  TextIs text = TextIs::anything;  ///< of a string
  std::string pattern;             ///< of a text_or_integer: a regular expression of JSON Schema
  std::vector<std::string> choices;
  std::vector<ParameterType> element;  ///< one, of a list or map
  std::vector<ParameterInfo> members;  ///< of an object

  /// "number", "list of 3 numbers", "duration", "choice" ...
  std::string name() const;
  /// "0 to 255", "at least 1 ms", "" for none; of the elements for a list.
  std::string range() const;
};

struct ParameterInfo {
  std::string key;
  ParameterType type;
  std::string unit;          ///< UCUM, of a number
  ConfigItem default_value;  ///< null for none
  bool required = false;
  OnlyWith only_with;
  NamesPart names_part;
  std::vector<std::string> placeholders;  ///< that the text may contain
  std::string doc;

  /// The default as one writes it in the file, strings without quotes; "" for none.
  std::string default_text() const;
};

/// A draft-07 JSON Schema of an object with these parameters and no others, as JSON text.
std::string schema(const std::vector<ParameterInfo>& parameters, std::string_view title, std::string_view doc);

/// The documentation of a type besides its parameters. Only pages and listings use it.
struct TypePage {
  std::string bus = {};                       ///< of a driver: the type of its bus
  std::vector<std::string> other_buses = {};  ///< of a driver that has a choice: the other types
  std::string notes = {};                     ///< Markdown: wiring, addresses, limits
  std::string aliases = {};                   ///< further search words, separated by blanks
  /// The description of its events with default parameters; null: not known without the parameters.
  std::shared_ptr<const Description> (*publishes)() = nullptr;
  bool depends_on_parameters = false;        ///< the description of its events depends on the parameters
  std::span<const KnownChip> chips = {};     ///< that it can be set to
  std::span<const ChipSample> samples = {};  ///< chips that work, for tests
};

/// A type in a registry, by its name in the file.
struct TypeInfo {
  std::string name;
  std::string doc;
  std::vector<ParameterInfo> parameters;
  TypePage page = {};

  /// The schema of an item of this type: `{"type": "analog", ...}`. `key`: what names the type.
  std::string schema(std::string_view key = "type") const;
};

/// Where the documentation of a type contains a search word, best match first.
enum class WordIn {
  nothing,
  notes,        ///< in the notes or the meaning of a parameter: "sht31" of sht
  description,  ///< "pt100" of max31865, "button" of edge, "temperature" of several
  choice,       ///< a choice of `model`, `format` or `quantity`, or an alias: "bme280" of barometer
};
struct WordFound {
  WordIn in = WordIn::nothing;
  std::string key = {};  ///< of the parameter whose choice it is
  std::string choice = {};
};
/// Searches the documentation of a type for a word, such as the name of a chip or a common name. Case, "-" and "_" are
/// ignored: "MPU-6050" is "mpu6050".
WordFound find_word(const TypeInfo& type, std::string_view word);
/// The indexes in `types` of the best matches; empty: no match.
std::vector<std::size_t> types_for_word(const std::vector<TypeInfo>& types, std::string_view word);

/// The schema of an item of any of these types, with the parameters of the type that it names. `by_default`: the type
/// of an item without a type; empty: the type is required.
std::string schema(const std::vector<TypeInfo>& types, std::string_view key = "type", std::string_view by_default = "");

}  // namespace rtdata
