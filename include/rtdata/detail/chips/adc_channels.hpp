/// Selectable channels of converters: the common part of their drivers (ads1x15.hpp, mcp3x08.hpp).
///
/// A channel is an input ("0": against ground; "0-1": input 0 minus input 1) with a name for its field in the events.
/// Default names: "ain0" and "ain0_ain1".
///
/// Values; any thread.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/error.hpp"

namespace rtdata {

namespace detail {

inline constexpr std::size_t most_channels = 8;

/// The name of a channel's field. `channel` has a `name` and an `input`.
template <class Channel>
std::string field_of(const Channel& channel) {
  if (!channel.name.empty()) return channel.name;
  std::string name = "ain";
  for (const char c : channel.input) {
    if (c == '-')
      name += "_ain";
    else
      name += c;
  }
  return name;
}

/// The chosen channels or, where none are chosen, each of the first `count` inputs against ground.
template <class Channel, class Inputs>
std::vector<Channel> chosen_or_all(std::vector<Channel> channels, const Inputs& inputs, std::size_t count) {
  if (!channels.empty()) return channels;
  channels.resize(count);
  for (std::size_t i = 0; i < count; ++i) channels[i].input = std::string(inputs[i]);
  return channels;
}

/// The description of a record "adc", a double a channel, in V. Errors: bad-description (too many channels, an invalid
/// or duplicate name).
template <class Channel>
Result<std::shared_ptr<const Description>> describe_channels(const std::vector<Channel>& channels,
                                                             DescriptionBuilder::Presence presence) {
  const auto refused = [](std::string why, std::string advice) {
    return Error{Errc::bad_description, "cannot use these channels", "channels", std::move(why), std::move(advice)};
  };
  if (channels.size() > most_channels)
    return refused("there are more than 8 channels", "put some of them into another sensor");
  DescriptionBuilder builder("adc");
  for (const Channel& channel : channels) builder.field(field_of(channel), Kind::f64, "V", presence);
  auto made = builder.build();
  if (!made) return refused(made.error().why, "give each channel a `name` of its own");
  return made;
}

/// The index of the input in the converter's list, or the error of channel number `at`.
template <class Inputs>
Result<std::size_t> find_input(const Inputs& inputs, std::string_view input, std::size_t at) {
  std::string all;
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    if (inputs[i] == input) return i;
    all += (i == 0 ? "" : i + 1 == inputs.size() ? " and " : ", ") + std::string(inputs[i]);
  }
  return Error{Errc::bad_argument, "cannot use this channel", "channels[" + std::to_string(at) + "].input",
               "it has no input \"" + std::string(input) + "\"", "choose one of its inputs: " + all};
}

}  // namespace detail
}  // namespace rtdata
