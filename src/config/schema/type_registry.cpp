#include "rtdata/detail/config/type_registry.hpp"

#include "data/listed.hpp"

namespace rtdata {

TypeRegistryBase::TypeRegistryBase(std::string what, std::vector<ParameterInfo> common)
    : what_(std::move(what)), common_(std::move(common)) {}

TypeInfo TypeRegistryBase::info_of(const Type& type) const {
  TypeInfo info{type.name, type.doc, common_, type.page};
  for (const config_detail::TableOf table : type.configs) {
    const std::vector<ParameterInfo> own = config_detail::list_parameters(table());
    info.parameters.insert(info.parameters.end(), own.begin(), own.end());
  }
  return info;
}

std::vector<TypeInfo> TypeRegistryBase::types() const {
  std::vector<TypeInfo> infos;
  for (const Type& type : types_) infos.push_back(info_of(type));
  return infos;
}

std::optional<TypeInfo> TypeRegistryBase::find(std::string_view name) const {
  for (const Type& type : types_)
    if (type.name == name) return info_of(type);
  return std::nullopt;
}

void TypeRegistryBase::add_type(std::string type, std::string doc, std::vector<config_detail::TableOf> configs,
                                TypePage page) {
  for (const Type& other : types_) {
    if (other.name == type)
      throw SetupError({Errc::bad_argument, "cannot add the " + what_ + " type \"" + type + "\"", "",
                        "there is one of this name already", "choose another name"});
  }
  types_.push_back({std::move(type), std::move(doc), std::move(configs), std::move(page)});
}

void TypeRegistryBase::leave_out(std::string type, std::string why) {
  left_out_.emplace_back(std::move(type), std::move(why));
}

const std::string* TypeRegistryBase::why_left_out(std::string_view type) const noexcept {
  for (const auto& [name, why] : left_out_)
    if (name == type) return &why;
  return nullptr;
}

std::size_t TypeRegistryBase::type_of(const ConfigItem& item, Problems& problems) const {
  if (!config_detail::check_is_object(item, problems)) return none;
  std::vector<std::string> names;
  for (const Type& known : types_) names.push_back(known.name);
  std::string listed = detail::listed(names);
  const ConfigItem* type = nullptr;
  for (const ConfigChild& child : item.children())
    if (child.key == "type") type = &child.item;
  if (type == nullptr && !default_.empty()) {
    for (std::size_t i = 0; i < types_.size(); ++i)
      if (types_[i].name == default_) return i;
    const std::string* why = why_left_out(default_);
    problems.add(item.problem("unknown-type", "a " + what_ + " cannot be made" + (why != nullptr ? ": " + *why : "")));
    return none;
  }
  if (type == nullptr) {
    problems.add(
        item.problem("missing-key", "\"type\" is missing: the type of the " + what_ +
                                        (listed.empty() ? ", of which there are none" : ", one of " + listed)));
    return none;
  }
  std::string_view name;
  if (!config_detail::read_string(*type, name, problems)) return none;
  for (std::size_t i = 0; i < types_.size(); ++i)
    if (types_[i].name == name) return i;
  std::string message = "there is no " + what_ + " type \"" + std::string(name) + "\"";
  if (const std::string* why = why_left_out(name)) {
    problems.add(type->problem("unknown-type", message + ": " + *why));
    return none;
  }
  std::string suggestion;
  const std::vector<TypeInfo> infos = types();
  const std::vector<std::size_t> meant = types_for_word(infos, name);
  if (meant.size() == 1) {
    suggestion = infos[meant[0]].name;
    const WordFound found = find_word(infos[meant[0]], name);
    if (!found.key.empty())
      message += "; it is type \"" + suggestion + "\" with \"" + found.key + "\": \"" + found.choice + "\"";
  } else {
    suggestion = nearest_name(name, names);
    std::string several;
    for (const std::size_t i : meant) several += (several.empty() ? "" : ", ") + infos[i].name;
    if (suggestion.empty() && !meant.empty()) listed = several;
  }
  if (suggestion.empty()) message += listed.empty() ? "; there are none" : "; available: " + listed;
  problems.add(type->problem("unknown-type", std::move(message), std::move(suggestion)));
  return none;
}

std::size_t TypeRegistryBase::read(const ConfigItem& item, ConfigObjects& configs, Problems& problems) const {
  const std::size_t type = type_of(item, problems);
  if (type == none) return none;
  std::vector<config_detail::ConfigPart> parts;
  for (const config_detail::TableOf table : types_[type].configs) {
    configs.push_back(config_detail::make_config(table()));
    parts.push_back({&table(), configs.back().get()});
  }
  return config_detail::read_object(parts, item, UnknownKeys::report, other_keys(), problems) ? type : none;
}

bool TypeRegistryBase::check(const ConfigItem& item, Problems& problems) const {
  ConfigObjects configs;
  return read(item, configs, problems) != none;
}

std::string TypeRegistryBase::type_named_by(const ConfigItem& item) const {
  for (const ConfigChild& child : item.children())
    if (child.key == "type") return child.item.as_string() != nullptr ? *child.item.as_string() : "";
  return default_;
}

std::vector<std::string> TypeRegistryBase::other_keys() const {
  std::vector<std::string> keys{"type"};
  for (const ParameterInfo& parameter : common_) keys.push_back(parameter.key);
  return keys;
}

Error TypeRegistryBase::placed(Error error, const ConfigItem& item) {
  const std::string place = item.problem("", "").error().where;
  if (!place.empty()) error.where = error.where.empty() ? place : place + ": " + error.where;
  return error;
}

}  // namespace rtdata
