#include "rtdata/sensors/derived.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "process/expression_names.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

using detail::is_number;
using detail::leaf_of;
using detail::Meaning;
using detail::meaning_of;

constexpr const char* cannot_derive = "cannot derive a value";

std::vector<DerivedField> fields_of(const DerivedConfig& config) {
  if (!config.expression.empty()) return {{"value", config.expression, config.unit}};
  return config.fields;
}

/// Why the configuration cannot work, its expressions apart; empty: it can.
std::string refusal_of(const DerivedConfig& config) {
  if (config.expression.empty() == config.fields.empty())
    return config.fields.empty() ? "it has no `expression`, and no `fields`"
                                 : "give `expression` or `fields`, not both";
  if (!config.unit.empty() && config.expression.empty())
    return "`unit` is that of `expression`; each of `fields` has one";
  if (!is_topic_name(config.on)) return "\"" + config.on + "\" is no topic";
  for (const std::string& topic : config.with)
    if (!is_topic_name(topic)) return "\"" + topic + "\" is no topic";
  for (std::size_t i = 0; i < config.with.size(); ++i)
    if (config.with[i] == config.on || std::find(config.with.begin(), config.with.begin() + std::ptrdiff_t(i),
                                                 config.with[i]) != config.with.begin() + std::ptrdiff_t(i))
      return "the topic \"" + config.with[i] + "\" is there twice";
  return "";
}

std::vector<std::string> topics_of(const DerivedConfig& config) {
  std::vector<std::string> topics{config.on};
  topics.insert(topics.end(), config.with.begin(), config.with.end());
  return topics;
}

/// All names that the fields use. Of texts with a mistake, none.
std::vector<std::string> names_of(const std::vector<DerivedField>& fields) {
  std::vector<std::string> names;
  for (const DerivedField& field : fields) {
    const auto used = Expression::names_in(field.expression);
    if (!used) continue;
    for (const std::string& name : *used)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  }
  return names;
}

/// Where the text of an expression is written.
const ConfigItem& expression_item(const DerivedConfig& config, const ConfigItem& item, std::size_t field) {
  const ConfigItem* at = config.expression.empty() ? nullptr : item.find("expression");
  if (const ConfigItem* fields = item.find("fields"); at == nullptr && fields != nullptr)
    if (const ConfigItem* one = fields->find(field); one != nullptr) at = one->find("expression");
  return at != nullptr ? *at : item;
}

/// At its column in the file, as far as no escapes are before it.
Problem problem_of(const ExpressionMistake& mistake, const ConfigItem& at) {
  Problem problem = at.problem("bad-value", mistake.why + " (column " + std::to_string(mistake.column) + " of it)",
                               mistake.suggestion);
  if (problem.place.line > 0) problem.place.column += mistake.column;
  return problem;
}

}  // namespace

namespace detail {

class DerivedNode final : public FeedNode {
 public:
  DerivedNode(Loop& loop, const FeedConfig& feed, const DerivedConfig& config,
              const std::shared_ptr<const Description>& description)
      : FeedNode(loop.core(), feed, described_type(description)), age_(config.age), description_(description) {
    const std::vector<DerivedField> fields = fields_of(config);
    const std::vector<std::string> names = names_of(fields);
    payload_.resize(description->size());
    for (std::size_t i = 0; i < fields.size(); ++i)
      outputs_.push_back({Expression(fields[i].expression, names), &description->leaves()[i]});
    for (std::size_t i = 0; i <= config.with.size(); ++i) {
      Source source;
      source.topic = i == 0 ? config.on : config.with[i - 1];
      for (std::size_t n = 0; n < names.size(); ++n)
        if (Meaning meaning = meaning_of(topics_of(config), names[n]); meaning.topic == i)
          source.inputs.push_back({n, names[n], std::move(meaning), nullptr});
      sources_.push_back(std::move(source));
    }
  }

  /// Apart, since a subscription may fail.
  void subscribe(Loop& loop) {
    for (std::size_t i = sources_.size(); i-- > 0;) {
      subscriptions_.push_back(
          loop.subscribe(sources_[i].topic, [this, i](const EventView& event) { take(i, event); }));
      subscriptions_.back().set_name("sensor " + origin_.name + " on " + sources_[i].topic);
    }
  }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    for (Output& output : outputs_) output.expression.reset();
    for (Source& source : sources_) source.has_come = false;
  }

 private:
  struct Input {
    std::size_t index;  // among the names of all expressions
    std::string name;
    Meaning meaning;
    const Leaf* leaf;
  };
  struct Source {
    std::string topic = {};
    std::vector<Input> inputs = {};
    std::uint64_t description = 0;  // of which the leaves are; 0: none yet
    const Input* missing = nullptr;
    bool has_come = false;
    Time time{};
  };
  struct Output {
    Expression expression;
    const Leaf* leaf;
  };

  void take(std::size_t from, const EventView& event) {
    if (!is_running()) return;
    Call call(*this);
    Source& source = sources_[from];
    if (source.description != event.description().serial()) bind(source, event.description());
    source.has_come = true;
    source.time = event.time();
    if (source.missing == nullptr) {
      for (const Input& input : source.inputs) {
        const std::byte* const at = find_value(*input.leaf, event.payload().data());
        for (Output& output : outputs_) {
          if (!output.expression.uses(input.index)) continue;
          if (at != nullptr)
            output.expression.set(input.index, number_of(*input.leaf, at));
          else
            output.expression.set_unknown(input.index);
        }
      }
    }
    if (from == 0) derive(event.time());
  }

  void bind(Source& source, const Description& description) {
    source.description = description.serial();
    source.missing = nullptr;
    for (Input& input : source.inputs) {
      input.leaf = leaf_of(description, input.meaning, input.name);
      if (input.leaf == nullptr && source.missing == nullptr) source.missing = &input;
    }
  }

  void derive(Time time) {
    for (const Source& source : sources_) {
      if (source.missing != nullptr) {
        fail({Errc::not_found, cannot_derive, object_name(),
              "the topic \"" + source.topic + "\" has no number `" + source.missing->name + "`",
              "look at its fields, and at the expression"});
        return;
      }
      if (source.inputs.empty() ||
          (source.has_come && (&source == &sources_[0] || span_between(source.time, time) <= age_)))
        continue;
      // Told once, and again when it is another topic that is missing.
      if (health() == Health::faulted && absent_ == &source) return;
      absent_ = &source;
      fault({Errc::timed_out, cannot_derive, object_name(),
             "the topic \"" + source.topic + "\" has brought nothing" +
                 (source.has_come ? " for more than " + to_string(age_) : std::string(" yet")),
             "it goes on with the next event of that topic; a longer `age` bridges longer pauses"});
      return;
    }
    const Output* failed = nullptr;
    for (Output& output : outputs_) {  // all of them, since memories take in each event
      const ExpressionResult result = output.expression.evaluate(time);
      if (result.has_failed() && failed == nullptr) failed = &output;
      std::byte* const optional = payload_.data() + output.leaf->offset;
      std::byte* const to = output.leaf->optional->set(optional, result.has_value());
      if (to != nullptr) std::memcpy(to, &result.value, sizeof result.value);
    }
    if (failed != nullptr) {
      fail({Errc::bad_data, cannot_derive, object_name() + ", field " + failed->leaf->path, failed->expression.why(),
            "guard the expression, as in `x != 0 ? 1 / x : 0`, or look at what is measured"});
      return;
    }
    publish(payload_.data(), time);
  }

  void on_close() noexcept override {
    subscriptions_.clear();
    FeedNode::on_close();
  }

  Duration age_;
  std::shared_ptr<const Description> description_;
  std::vector<Output> outputs_;
  std::vector<Source> sources_;
  std::vector<Subscription> subscriptions_;
  std::vector<std::byte> payload_;
  const Source* absent_ = nullptr;
};

}  // namespace detail

Result<std::shared_ptr<const Description>> derived_description(const DerivedConfig& config) {
  DescriptionBuilder builder("derived");
  const std::vector<DerivedField> fields = fields_of(config);
  if (fields.empty())
    return Error{Errc::bad_description, cannot_derive, "", "there is no expression",
                 "give it `expression` or `fields`"};
  for (const DerivedField& field : fields)
    builder.field(field.name, Kind::f64, field.unit, DescriptionBuilder::Presence::optional);
  return builder.build();
}

void check_config(const DerivedConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string why = refusal_of(config); !why.empty()) problems.add(item.problem("bad-value", why));
  if (const auto described = derived_description(config); !described && !fields_of(config).empty())
    problems.add(item.problem("bad-value", described.error().why));
  const std::vector<DerivedField> fields = fields_of(config);
  for (std::size_t i = 0; i < fields.size(); ++i) {
    const std::string& text = fields[i].expression;
    if (const auto mistake = Expression::check(text, names_of({fields[i]})))
      problems.add(problem_of(*mistake, expression_item(config, item, i)));
  }
}

void check_derived_names(const DerivedConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems) {
  const std::vector<DerivedField> fields = fields_of(config);
  for (std::size_t i = 0; i < fields.size(); ++i) {
    std::vector<std::string> names = names_of({fields[i]});
    // A constant where there is a field of that name: nobody would see that the field is not looked at.
    const Description* const payload = payload_of(config.on);
    for (const char* constant : {"e", "pi", "true", "false"}) {
      if (payload == nullptr || payload->find(constant) == nullptr) continue;
      const auto with_it = Expression::names_in(fields[i].expression, {constant});
      if (!with_it || with_it->size() == names.size()) continue;
      problems.add(
          expression_item(config, item, i)
              .problem("bad-value", "`" + std::string(constant) + "` is the constant, and a field of the topic \"" +
                                        config.on + "\": the field is written '" + constant + "', in quotes; `" +
                                        Expression::normal_name(config.on) + "." + constant + "` is the same"));
    }
    std::vector<std::string> good;
    bool is_all_good = true;
    for (const std::string& name : names) {
      const Meaning meaning = meaning_of(topics_of(config), name);
      const Description* const description = payload_of(meaning.topic == 0 ? config.on
                                                                           : config.with[meaning.topic - 1]);
      if (description == nullptr || leaf_of(*description, meaning, name) != nullptr)
        good.push_back(name);
      else
        is_all_good = false;
    }
    if (is_all_good) continue;
    // What could have been meant.
    for (std::size_t topic = 0; topic <= config.with.size(); ++topic) {
      const std::string& of = topic == 0 ? config.on : config.with[topic - 1];
      const Description* const description = payload_of(of);
      if (description == nullptr) continue;
      for (const Leaf& leaf : description->leaves()) {
        if (!is_number(leaf)) continue;
        const std::string full = Expression::normal_name(of) + "." + leaf.path;
        for (const std::string& name : topic == 0 ? std::vector{leaf.path, full} : std::vector{full})
          if (std::find(good.begin(), good.end(), name) == good.end()) good.push_back(name);
      }
    }
    if (const auto mistake = Expression::check(fields[i].expression, good))
      problems.add(problem_of(*mistake, expression_item(config, item, i)));
  }
}

DerivedSensor::DerivedSensor(Loop& loop, FeedConfig feed, DerivedConfig config) {
  if (const std::string why = refusal_of(config); !why.empty())
    throw SetupError({Errc::bad_argument, cannot_derive, "sensor " + feed.name, why, ""});
  auto* const node = new detail::DerivedNode(loop, feed, config, derived_description(config).or_throw());
  *this = DerivedSensor(node);
  node->subscribe(loop);
}

}  // namespace rtdata
