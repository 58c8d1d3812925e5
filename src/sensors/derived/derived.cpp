#include "rtdata/sensors/derived.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "loop/events/made_of.hpp"
#include "process/expression_sources.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_derive = "cannot derive a value";

std::vector<DerivedField> fields_of(const DerivedConfig& config) {
  if (!config.expression.empty()) return {{"value", config.expression, config.unit}};
  return config.fields;
}

/// Why the configuration is invalid, apart from its expressions; empty: it is valid.
std::string refusal_of(const DerivedConfig& config) {
  if (config.expression.empty() == config.fields.empty())
    return config.fields.empty() ? "it has neither `expression` nor `fields`"
                                 : "use `expression` or `fields`, not both";
  if (!config.unit.empty() && config.expression.empty())
    return "`unit` works only with `expression`: set the `unit` of each of `fields` instead";
  if (!is_topic_name(config.on)) return "\"" + config.on + "\" is not a topic";
  for (const std::string& topic : config.with)
    if (!is_topic_name(topic)) return "\"" + topic + "\" is not a topic";
  for (std::size_t i = 0; i < config.with.size(); ++i)
    if (config.with[i] == config.on || std::find(config.with.begin(), config.with.begin() + std::ptrdiff_t(i),
                                                 config.with[i]) != config.with.begin() + std::ptrdiff_t(i))
      return "the topic \"" + config.with[i] + "\" is listed twice";
  return "";
}

/// Where the text of an expression is written.
const ConfigItem& expression_item(const DerivedConfig& config, const ConfigItem& item, std::size_t field) {
  const ConfigItem* at = config.expression.empty() ? nullptr : item.find("expression");
  if (const ConfigItem* fields = item.find("fields"); at == nullptr && fields != nullptr)
    if (const ConfigItem* one = fields->find(field); one != nullptr) at = one->find("expression");
  return at != nullptr ? *at : item;
}

}  // namespace

namespace detail {

class DerivedNode final : public FeedNode {
 public:
  DerivedNode(Loop& loop, const FeedConfig& feed, const DerivedConfig& config,
              const std::shared_ptr<const Description>& description)
      : FeedNode(loop.core(), feed, described_type(description)), age_(config.age), description_(description) {
    set_numbered();  // it makes its events itself
    const std::vector<DerivedField> fields = fields_of(config);
    std::vector<std::string> texts;
    for (const DerivedField& field : fields) texts.push_back(field.expression);
    const std::vector<std::string> names = names_of(texts);
    sources_ = ExpressionSources(topics_of(config.on, config.with), names);
    payload_.resize(description->size());
    for (std::size_t i = 0; i < fields.size(); ++i)
      outputs_.push_back({Expression(fields[i].expression, names), &description->leaves()[i]});
  }

  /// Separate, because a subscription may fail.
  void subscribe(Loop& loop) {
    subscriptions_ = sources_.subscribe(loop, "sensor " + origin_.name,
                                        [this](std::size_t from, const EventView& event) { take(from, event); });
    set_made_of(origin_, sources_.topics());
    recall();
  }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    for (Output& output : outputs_) output.expression.reset();
    sources_.forget();
    recall();
  }

 private:
  /// Takes the last events of topics `with` that publish only changes.
  void recall() {
    sources_.recall(loop()->face, [this](std::size_t from, const EventView& event) {
      if (from != 0) take(from, event);
    });
  }

  struct Output {
    Expression expression;
    const Leaf* leaf;
  };

  void take(std::size_t from, const EventView& event) {
    if (!is_running()) return;
    Call call(*this);
    sources_.put(from, event, [this](std::size_t name, std::optional<double> number) {
      for (Output& output : outputs_)
        if (output.expression.uses(name)) set_or_unknown(output.expression, name, number);
    });
    if (from == 0) derive(event.time());
  }

  void derive(Time time) {
    if (const ExpressionSources::Source* const lacking = sources_.lacking(time, age_)) {
      if (lacking->missing != nullptr)
        return fail({Errc::not_found, cannot_derive, object_name(), ExpressionSources::why(*lacking, age_),
                     "check its fields, and the expression"});
      // Reported once, and again if another topic is missing.
      if (health() == Health::faulted && absent_ == lacking) return;
      absent_ = lacking;
      return fault({Errc::timed_out, cannot_derive, object_name(), ExpressionSources::why(*lacking, age_),
                    "the sensor continues with the next event of that topic; a longer `age` bridges longer pauses"});
    }
    const Output* failed = nullptr;
    for (Output& output : outputs_) {  // all of them, because memories use each event
      const ExpressionResult result = output.expression.evaluate(time);
      if (result.has_failed() && failed == nullptr) failed = &output;
      std::byte* const optional = payload_.data() + output.leaf->offset;
      std::byte* const to = output.leaf->optional->set(optional, result.has_value());
      if (to != nullptr) std::memcpy(to, &result.value, sizeof result.value);
    }
    if (failed != nullptr) {
      fail({Errc::bad_data, cannot_derive, object_name() + ", field " + failed->leaf->path, failed->expression.why(),
            "guard the expression, as in `x != 0 ? 1 / x : 0`, or check the measured value"});
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
  ExpressionSources sources_{{}, {}};
  std::vector<Subscription> subscriptions_;
  std::vector<std::byte> payload_;
  const ExpressionSources::Source* absent_ = nullptr;
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
  for (std::size_t i = 0; i < fields.size(); ++i)
    detail::check_expression(fields[i].expression, expression_item(config, item, i), problems);
}

void check_derived_names(const DerivedConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems) {
  const std::vector<DerivedField> fields = fields_of(config);
  for (std::size_t i = 0; i < fields.size(); ++i) {
    detail::check_field_names(fields[i].expression, detail::topics_of(config.on, config.with), payload_of,
                              expression_item(config, item, i), problems);
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
