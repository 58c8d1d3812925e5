/// ConfigItem: one item of a configuration, with everything below it.
///
/// A configuration is an n-ary tree of null, booleans, integers, numbers, strings, arrays and objects; objects keep the
/// order in which they were written. An item is a value: a copy is a tree of its own, and changing an item changes
/// neither its parent nor its siblings. Each item knows the place in the file it came from and its path in the tree,
/// and a copy keeps both, so that a message about a mistake can always show its place.
///
///     rtdata::ConfigItem config = rtdata::load_config("bench.json").or_throw();
///     double volts = config.at("sensors", 0, "span_voltage").get<double>();   // or at("sensors[0].span_voltage")
///     auto topics = config.at("sinks[0].topics").get<std::vector<std::string>>();
///     auto name = config.value_or("name", std::string("unnamed"));
///     for (const auto& [key, item] : config.children()) std::cout << key << " is " << item.describe() << "\n";
///     config.at("sensors[0]").set("rate", 50_Hz);
///
/// Errors: a missing item or one of another type throws `ConfigError` with place and path. No value is converted with
/// loss: 3.7 is not an int, 300 not a uint8, true not a number, and "10" not a duration.
///
/// `get` and `set` of a type need its `ConfigValue`: those of the standard types are in config_value.hpp, which
/// format.hpp includes.
///
/// Values; different items may be used by different threads, one item by one at a time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "rtdata/data/problem.hpp"

namespace rtdata {

struct ConfigChild;
class ConfigBuilder;
/// How a type is read from an item and written to one; see config_value.hpp. Specialise it for types of your own.
template <class T>
struct ConfigValue;

class ConfigItem {
 public:
  enum class Kind : std::uint8_t {
    null,
    boolean,
    integer,  ///< written without a point and exponent, and fits 64 bits (signed or unsigned)
    number,   ///< any other number
    string,
    array,
    object,
  };

  /// Null, without a place.
  ConfigItem();
  ConfigItem(const ConfigItem&);
  ConfigItem(ConfigItem&&) noexcept;
  ConfigItem& operator=(const ConfigItem&);
  ConfigItem& operator=(ConfigItem&&) noexcept;
  ~ConfigItem();
  static ConfigItem array();
  static ConfigItem object();
  /// An item of any value that `set` takes.
  template <class T>
  static ConfigItem of(const T& value);

  Kind kind() const noexcept;
  bool is_null() const noexcept { return kind() == Kind::null; }
  bool is_array() const noexcept { return kind() == Kind::array; }
  bool is_object() const noexcept { return kind() == Kind::object; }
  /// A text for users: `the string "abc"`, `the number 3.7`, `true`, `null`, `a list`, `an object`. Long strings are
  /// cut.
  std::string describe() const;

  /// Where its value begins in the file.
  ConfigPlace place() const;
  /// Where its key begins; the same as `place` for an array element and the root.
  ConfigPlace key_place() const;
  /// "sensors[2].rate"; empty for the root. A key with other characters than letters, digits, '_', '-', '$' and '/' is
  /// written `["a.b"]`.
  std::string path() const;

  // Reading ---------------------------------------------------------------------------------------------------------

  /// The child with this key, or else the item at this path ("sensors[2].rate"). Null if there is none.
  const ConfigItem* find(std::string_view key_or_path) const;
  ConfigItem* find(std::string_view key_or_path);
  /// The n-th element of an array or, in order, child of an object. Null when there is none.
  const ConfigItem* find(std::size_t index) const;
  ConfigItem* find(std::size_t index);

  /// As `find`, with one argument for each level: at("sensors", 2, "rate"). Throws ConfigError if the item is missing.
  template <class Step, class... Steps>
  const ConfigItem& at(const Step& step, const Steps&... steps) const {
    const ConfigItem& child = step_to(step);
    if constexpr (sizeof...(steps) == 0)
      return child;
    else
      return child.at(steps...);
  }
  template <class... Steps>
  ConfigItem& at(const Steps&... steps) {
    return const_cast<ConfigItem&>(std::as_const(*this).at(steps...));
  }

  /// Elements of an array (their keys are empty) or members of an object, in order; none for anything else.
  /// Valid until the item is changed.
  std::span<const ConfigChild> children() const noexcept;
  std::size_t size() const noexcept;
  std::vector<std::string> keys() const;

  /// The value as a standard type: bool, any integer, float, double, char, std::string, std::string_view (into this
  /// item, until it is changed), Duration and every std::chrono duration, Rate, std::optional (null is none),
  /// std::array, std::vector and other containers, std::map<std::string, T>. Throws ConfigError when it is something
  /// else.
  template <class T>
  T get() const {
    T value{};
    Problems problems;
    if (!ConfigValue<T>::read(*this, value, problems)) throw ConfigError(std::move(problems));
    return value;
  }
  /// As `get`, with the error as a result.
  template <class T>
  Result<T> try_get() const {
    T value{};
    Problems problems;
    if (!ConfigValue<T>::read(*this, value, problems)) return problems[0].error();
    return value;
  }
  /// The value of a child, or `otherwise` if there is no such child. A child of another type throws.
  template <class T>
  T value_or(std::string_view key_or_path, T otherwise) const {
    const ConfigItem* child = find(key_or_path);
    if (child == nullptr) return otherwise;
    return child->get<T>();
  }

  // Changing --------------------------------------------------------------------------------------------------------

  /// Sets the value: any type that `get` returns, a string literal, nullptr or another item with its children. Parent
  /// and siblings stay as they are, and so do place and path. A number that is not finite throws SetupError
  /// (bad-argument): no file can hold it.
  template <class T>
  void set(const T& value) {
    if constexpr (std::is_same_v<T, ConfigItem>)
      set_item(value);
    else if constexpr (std::is_null_pointer_v<T>)
      set_null();
    else if constexpr (std::is_convertible_v<const T&, std::string_view>)
      set_string(std::string_view(value));
    else
      ConfigValue<T>::write(value, *this);
  }
  /// Sets a child of an object, adding it at the end when there is none. A null item becomes an object first; any other
  /// kind throws SetupError (bad-argument).
  template <class T>
  void set(std::string_view key, const T& value) {
    child_for(key).set(value);
  }
  /// Adds an element to an array and returns it. A null item becomes an array first; any other kind throws SetupError.
  template <class T>
  ConfigItem& push_back(const T& value) {
    ConfigItem& element = new_element();
    element.set(value);
    return element;
  }
  /// Removes a child; false when there is none. Elements behind it move up, and their paths with them.
  bool remove(std::string_view key);
  bool remove(std::size_t index);

  void set_null();
  void set_boolean(bool value);
  void set_integer(std::int64_t value);
  void set_integer(std::uint64_t value);
  void set_number(double value);
  void set_string(std::string_view value);
  void set_item(const ConfigItem& other);

  // Text ------------------------------------------------------------------------------------------------------------

  enum class Layout { indented, one_line };
  /// JSON that reads back as an equal tree: numbers as they were written, objects in their order. Comments are gone.
  std::string to_json(Layout layout = Layout::indented) const;
  /// Same kind and value, children in the same order for arrays, in any order for objects. Places do not matter.
  bool operator==(const ConfigItem& other) const;

  // For ConfigValue -------------------------------------------------------------------------------------------------

  const bool* as_boolean() const noexcept { return std::get_if<bool>(&value_); }
  const std::string* as_string() const noexcept { return std::get_if<std::string>(&value_); }
  /// The text of a number as it was written; "" for other items.
  std::string number_text() const;
  /// The integer; null if the item is not one of this type.
  const std::int64_t* as_signed() const noexcept { return std::get_if<std::int64_t>(&value_); }
  const std::uint64_t* as_unsigned() const noexcept { return std::get_if<std::uint64_t>(&value_); }
  /// The double of an item of kind number.
  const double* as_number() const noexcept;
  /// A problem at this item's place and path.
  Problem problem(std::string id, std::string message, std::string suggestion = {}) const;

 private:
  friend class ConfigBuilder;
  struct Origin;
  struct Number {
    double value = 0;
    std::string literal;  ///< as it was written
  };
  using Children = std::vector<ConfigChild>;
  struct Array {
    Children children;
  };
  struct Object {
    Children children;
  };
  using Content = std::variant<std::monostate, bool, std::int64_t, std::uint64_t, Number, std::string, Array, Object>;

  const Children* child_list() const noexcept;
  Children* child_list() noexcept { return const_cast<Children*>(std::as_const(*this).child_list()); }
  const ConfigItem& step_to(std::string_view key_or_path) const;
  const ConfigItem& step_to(std::size_t index) const;
  template <class Integer>
  requires std::is_integral_v<Integer>
  const ConfigItem& step_to(Integer index) const {
    return step_to(static_cast<std::size_t>(index));  // a negative index becomes huge and is not found
  }
  const ConfigItem* follow(std::string_view path) const;
  ConfigItem& child_for(std::string_view key);
  ConfigItem& new_element();
  /// Sets `parent` as the parent in the paths of this item and all items below; places do not change.
  void move_below(const std::shared_ptr<const Origin>& parent, std::string_view key, std::size_t index, bool element);
  void renumber_from(std::size_t index);
  void rebuild_origins_of_children();

  Content value_;
  std::shared_ptr<const Origin> origin_;
};

/// A child of an array or object: `for (const auto& [key, item] : config.children())`.
struct ConfigChild {
  std::string key;  ///< empty in an array
  ConfigItem item;
};

inline ConfigItem::ConfigItem() = default;
inline ConfigItem::ConfigItem(const ConfigItem&) = default;
inline ConfigItem::ConfigItem(ConfigItem&&) noexcept = default;
inline ConfigItem& ConfigItem::operator=(const ConfigItem&) = default;
inline ConfigItem& ConfigItem::operator=(ConfigItem&&) noexcept = default;
inline ConfigItem::~ConfigItem() = default;

template <class T>
ConfigItem ConfigItem::of(const T& value) {
  ConfigItem item;
  item.set(value);
  return item;
}

}  // namespace rtdata
