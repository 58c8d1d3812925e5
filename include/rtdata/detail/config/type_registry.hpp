/// TypeRegistry: makes objects by the "type" that a configuration item names.
///
/// A registry is an object, not a global: a program fills one and passes it on. `Product` is the result of its
/// factories, `Context` their arguments besides the configuration.
///
///     rtdata::TypeRegistry<std::unique_ptr<Pump>, rtdata::Loop&> pumps("pump");
///     pumps.add<GearPumpConfig>(
///         "gear", "a gear pump with a step motor",
///         [](rtdata::Loop& loop, const GearPumpConfig& config) { return make_gear_pump(loop, config); });
///     pumps.check(item, problems);            // every mistake of the item, nothing is made
///     auto pump = pumps.create(item, loop);   // throws ConfigError with every mistake
///
/// `Registry` (config/registry.hpp) holds one for each kind of part.
///
/// Owner: the program; the objects that it made may outlive it. Filled by one thread, then read by any. Errors: adding
/// a type twice throws SetupError (bad-argument). An error of a factory gets the item's place in front.
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

/// The Config that an item was read into, or several Configs that share the keys of one object.
using ConfigObjects = std::vector<std::shared_ptr<void>>;

/// The common part of all registries.
class TypeRegistryBase {
 public:
  /// All types, in the order they were added; the common parameters come first in each.
  std::vector<TypeInfo> types() const;
  /// Nothing when there is no such type.
  std::optional<TypeInfo> find(std::string_view type) const;
  /// Registers the name of a type that this program was built without; messages then give the reason. `why`: "this
  /// program was built without libmodbus". A type of that name may still be added.
  void leave_out(std::string type, std::string why);
  /// The reason why a type is left out; null: it is not registered as left out.
  const std::string* why_left_out(std::string_view type) const noexcept;
  /// Sets the type of items without a "type" key; the type may be added later. Without a default, each item needs the
  /// key.
  void set_default(std::string type) { default_ = std::move(type); }
  /// The type of the item, or the default. Empty: neither.
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
  /// The index of the item's type; `none`, with a problem, if it is not registered.
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
  /// "type" and the common keys: allowed, but not part of the Config.
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
  /// `what`: the kind, for messages ("sensor"). `common`: parameters that items of every type have besides those of its
  /// Config, `parameters_of<Common>()`; the caller reads them itself with `read_config(item, common, problems,
  /// UnknownKeys::ignore)`.
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

  /// Makes the object of an item. Throws ConfigError if the item has mistakes, and the SetupError of the factory.
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
