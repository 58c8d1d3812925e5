#include "rtdata/config/registry.hpp"

namespace rtdata {

TypeRegistryBase::TypeRegistryBase(std::string what, std::vector<ParameterInfo> common)
    : what_(std::move(what)), common_(std::move(common)) {}

const TypeInfo* TypeRegistryBase::find(std::string_view type) const {
  for (const TypeInfo& info : types_)
    if (info.name == type) return &info;
  return nullptr;
}

void TypeRegistryBase::add_type(std::string type, std::string doc, std::vector<ParameterInfo> parameters) {
  if (find(type) != nullptr)
    throw SetupError({Errc::bad_argument, "cannot add the " + what_ + " type \"" + type + "\"", "",
                      "there is one of this name already", "choose another name"});
  parameters.insert(parameters.begin(), common_.begin(), common_.end());
  types_.push_back({std::move(type), std::move(doc), std::move(parameters)});
}

std::size_t TypeRegistryBase::type_of(const ConfigItem& item, Problems& problems) const {
  if (!config_detail::check_is_object(item, problems)) return none;
  std::vector<std::string> names;
  std::string listed;
  for (const TypeInfo& info : types_) {
    names.push_back(info.name);
    listed += (listed.empty() ? "" : ", ") + info.name;
  }
  const ConfigItem* type = nullptr;
  for (const ConfigChild& child : item.children())
    if (child.key == "type") type = &child.item;
  if (type == nullptr) {
    problems.add(item.problem("missing-key", "\"type\" is missing: the type of the " + what_ + ", one of " + listed));
    return none;
  }
  std::string_view name;
  if (!config_detail::read_string(*type, name, problems)) return none;
  for (std::size_t i = 0; i < types_.size(); ++i)
    if (types_[i].name == name) return i;
  std::string suggestion = nearest_name(name, names);
  std::string message = "there is no " + what_ + " type \"" + std::string(name) + "\"";
  if (suggestion.empty()) message += listed.empty() ? "; there are none" : "; there are " + listed;
  problems.add(type->problem("unknown-type", std::move(message), std::move(suggestion)));
  return none;
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
