/// TypeRegistry: makes objects by the "type" that a configuration item names.
///
/// A registry is an object, not a global: a program fills one and hands it on. `Product` is what its factories make,
/// `Context` what they are given beside the configuration.
///
///     TypeRegistry<std::unique_ptr<Pump>, Loop&> pumps("pump");
///     pumps.add<GearPumpConfig>(
///         "gear", "a gear pump with a step motor",
///         [](Loop& loop, const GearPumpConfig& config) { return make_gear_pump(loop, config); });
///     pumps.check(item, problems);            // every mistake of the item, nothing is made
///     auto pump = pumps.create(item, loop);   // throws ConfigError with every mistake
///
/// The registry of all kinds of parts that a configuration knows is `Registry` (config/registry.hpp), which is made of
/// these.
///
/// Owner: the program; it need not outlive what it made. Filled by one thread, then read by any.
/// Errors: adding a type twice throws SetupError (bad_argument). An error of a factory gets the item's place in front.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/config/read.hpp"

namespace rtdata {

/// What an item was read into: a Config, or several that share the keys of one object.
using ConfigObjects = std::vector<std::shared_ptr<void>>;

/// What all registries share.
class TypeRegistryBase {
 public:
  /// All types, in the order they were added; the common parameters come first in each.
  std::vector<TypeInfo> types() const;
  /// Nothing when there is no such type.
  std::optional<TypeInfo> find(std::string_view type) const;
  /// A type that this program lacks, as it was built without a library, is named with the reason, where somebody asks
  /// for it. `why`: "this program was built without libmodbus". It may be added all the same, with another meaning.
  void leave_out(std::string type, std::string why);
  /// Why a type is left out; null: it is not known as one that is.
  const std::string* why_left_out(std::string_view type) const noexcept;
  /// The type of items that do not say theirs; it may be added later. Without a call of this, each item says it.
  void set_default(std::string type) { default_ = std::move(type); }
  /// As the item says, or the default. Empty: neither.
  std::string type_named_by(const ConfigItem& item) const;
  /// The JSON Schema (draft-07) of an item of any type.
  std::string schema() const { return rtdata::schema(types(), "type", default_); }
  /// Reads the item as the type it names and adds every mistake to `problems`. True when there is none.
  bool check(const ConfigItem& item, Problems& problems) const;

 protected:
  static constexpr std::size_t none = static_cast<std::size_t>(-1);

  TypeRegistryBase(std::string what, std::vector<ParameterInfo> common);
  ~TypeRegistryBase() = default;
  TypeRegistryBase(const TypeRegistryBase&) = default;
  TypeRegistryBase& operator=(const TypeRegistryBase&) = default;
  TypeRegistryBase(TypeRegistryBase&&) = default;
  TypeRegistryBase& operator=(TypeRegistryBase&&) = default;

  void add_type(std::string type, std::string doc, std::vector<config_detail::TableOf> configs, TypePage page);
  /// Which type the item names; `none`, with a problem, when it names none of these.
  std::size_t type_of(const ConfigItem& item, Problems& problems) const;
  /// Reads the item as the type it names, which is `type`; `none`, with every problem, when it has mistakes.
  std::size_t read(const ConfigItem& item, ConfigObjects& configs, Problems& problems) const;
  static Error placed(Error error, const ConfigItem& item);

 private:
  struct Type {
    std::string name;
    std::string doc;
    std::vector<config_detail::TableOf> configs;
    TypePage page;
  };
  TypeInfo info_of(const Type& type) const;
  /// "type" and the common keys: known, but not the Config's.
  std::vector<std::string> other_keys() const;

  std::string what_;
  std::string default_;  // empty: none
  std::vector<ParameterInfo> common_;
  std::vector<Type> types_;
  std::vector<std::pair<std::string, std::string>> left_out_;  // type and reason
};

template <class Product, class... Context>
class TypeRegistry : public TypeRegistryBase {
 public:
  /// `what`: what a type is one of, in messages ("sensor"). `common`: parameters that items of every type have beside
  /// those of its Config, and that the caller reads itself: `parameters_of<Common>()` here, and
  /// `read_config(item, common, problems, UnknownKeys::ignore)` there.
  explicit TypeRegistry(std::string what, std::vector<ParameterInfo> common = {})
      : TypeRegistryBase(std::move(what), std::move(common)) {}

  template <Configurable Config>
  void add(std::string type, std::string doc, std::function<Product(Context..., const Config&)> factory,
           TypePage page = {}) {
    add(
        std::move(type), std::move(doc), {&config_detail::table_of<Config>},
        [factory = std::move(factory)](Context... context, const ConfigObjects& configs) -> Product {
          return factory(std::forward<Context>(context)..., *static_cast<const Config*>(configs[0].get()));
        },
        std::move(page));
  }
  /// The same, of several Configs, whatever their types.
  using Factory = std::function<Product(Context..., const ConfigObjects&)>;
  void add(std::string type, std::string doc, std::vector<config_detail::TableOf> configs, Factory factory,
           TypePage page = {}) {
    add_type(std::move(type), std::move(doc), std::move(configs), std::move(page));
    factories_.push_back(std::move(factory));
  }

  /// Makes what the item says. Throws ConfigError when it has mistakes, and SetupError what the factory threw.
  Product create(const ConfigItem& item, Context... context) const {
    Problems problems;
    ConfigObjects configs;
    const std::size_t type = read(item, configs, problems);
    if (type == none) throw ConfigError(std::move(problems));
    try {
      return factories_[type](std::forward<Context>(context)..., configs);
    } catch (const ConfigError&) {
      throw;
    } catch (const SetupError& error) {
      throw SetupError(placed(error.error(), item));
    }
  }

 private:
  std::vector<Factory> factories_;
};

}  // namespace rtdata
