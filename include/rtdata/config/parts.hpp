/// Parts: what a configuration names and a system is made of, whatever its kind: tiers, buses, sinks, sensors.
///
/// A `PartPlan` is one part as its item says, checked and not made yet. It knows its name, the parts that it uses and
/// how it is made. Each part is made after those that it uses and closed before them; otherwise tiers are made first,
/// then buses, sinks and sensors, and closed in the opposite order. `Parts` are those that are made.
///
/// Plans are values, for any thread. Parts: owner the System, thread that of the main loop; while a part is made on a
/// tier, that thread may look at them.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <typeinfo>
#include <utility>
#include <vector>

#include "rtdata/data/config_item.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

class Parts;
namespace config_detail {
class PlanApplication;
}

/// Owns what a part was made into, of any type. Destroying it closes the part. Move-only; empty when default-made or
/// moved from.
class PartObject {
 public:
  PartObject() noexcept = default;
  /// What `make()` returns, which need not be movable. It can be used as what it is and as a Base.
  template <class Base, class Make>
  static PartObject made_by(Make&& make) {
    PartObject object;
    object.holder_ = std::make_unique<HolderOf<Base, std::invoke_result_t<Make&>>>(make);
    return object;
  }

  /// Null when it can be used as no T.
  template <class T>
  T* as() const noexcept {
    return holder_ == nullptr ? nullptr : static_cast<T*>(holder_->as(typeid(T)));
  }

 private:
  struct Holder {
    virtual ~Holder() = default;
    virtual void* as(const std::type_info& type) noexcept = 0;
  };
  template <class Base, class T>
  struct HolderOf final : Holder {
    template <class Make>
    explicit HolderOf(Make& make) : object(make()) {}
    void* as(const std::type_info& type) noexcept override {
      if (type == typeid(Base)) return static_cast<Base*>(&object);
      return type == typeid(T) ? &object : nullptr;
    }
    T object;
  };
  std::unique_ptr<Holder> holder_;
};

/// A use of another part, which a parameter names (`names_part`, parameter.hpp).
struct PartUse {
  std::string kind;  ///< "bus"; "topic": whatever publishes it
  std::string name;
  std::vector<std::string> types;  ///< that the other may be of; empty: of any
  ConfigItem item;                 ///< that names it
};

/// A device's own pace; 0: not known, or it has none.
struct Sampling {
  double hertz = 0;          ///< samples a second that it takes by itself
  std::size_t kept = 0;      ///< samples that it keeps until they are read
  Duration reading_time{0};  ///< how long a reading takes at least
};

/// What a part publishes, as far as it is known before the part is made.
struct PublishedTopic {
  std::string topic;                               ///< never empty
  std::shared_ptr<const Description> description;  ///< null: known only once it is made
  std::optional<SensorLoad> load;                  ///< null: there is nothing to read, the program feeds it
  Sampling sampling = {};
  /// What expressions may name of it, where that is not what the description has: the states of a machine, too. Null:
  /// not known.
  std::optional<std::shared_ptr<const Description>> in_expressions = {};
};

/// What a part stores, and where.
struct StoredTopics {
  std::vector<std::string> topics;
  std::string path;             ///< the file it writes; "-" for standard output, empty for none
  Duration close_deadline{0};   ///< how long closing may wait for it
  bool is_recording = false;    ///< other sinks can go through it
  bool is_sender = false;       ///< its peer is across a network
  std::string through = {};     ///< the recording that it goes through; empty: none
  Duration batch_time{0};       ///< how long an event waits at most until it is stored, while nothing fails
  std::size_t queue_bytes = 0;  ///< memory for events that wait, at most
  /// Returns an error for each of the topics that the part cannot store; empty: not known before it is made.
  std::function<std::vector<Error>(std::span<const TopicToRecord>)> refused_topics = {};
  /// The file that a topic's events go to; empty: all go to `path`.
  std::function<std::string(std::string_view topic)> file_of_topic = {};
  /// Whether it makes, renames or removes `other` beside `file`, which it writes; both paths absolute. Empty: it has
  /// the files that it writes and no others.
  std::function<bool(const std::string& file, const std::string& other)> is_companion_file = {};
  /// Whether one of the files that it writes, which may be there or not, can be opened and locked now. Makes and
  /// changes nothing. Any thread; blocks on the disk. busy: another process writes it. Empty: not known before it is
  /// made.
  std::function<Result<void>(const std::string& file)> check_openable = {};

  bool wants(std::string_view topic) const noexcept;
};

struct PartPlan {
  std::string kind;  ///< "tier", "bus", "sink", "sensor"
  std::string type;  ///< empty for a tier
  std::string name;
  ConfigItem item;  ///< it was made from
  std::vector<PartUse> uses = {};
  std::vector<std::string> secrets = {};  ///< texts of the item that are to be shown nowhere
  std::optional<PublishedTopic> publishes = {};
  std::optional<StoredTopics> stores = {};
  std::string passes_on = {};  ///< the topic whose events it publishes again, on a topic of its own; empty: none
  std::string stored_by = {};  ///< the sink by which it wants its events to be stored; empty: by any
  /// The place that it takes for itself: on a bus, or a device of the machine.
  struct Place {
    std::string bus = {};              ///< empty: it is on none
    std::string text = {};             ///< "address 0x76"; without a bus "/dev/i2c-1"; empty: none
    std::string advice = {};           ///< to who wants it, too; empty: to take another
    std::string bus_type = {};         ///< of a bus that has such a place; empty: of any that the part may be on
    std::string advice_on_other = {};  ///< for one of another type
    std::string more = {};             ///< that tells it from others, and is shown nowhere, such as a path of a URL
  } place = {};
  std::vector<Place> more_places = {};  ///< the same, of a part that takes several
  Duration give_up_after{0};            ///< of a bus: what a sensor does on it for longer is given up; 0: not known
  Duration holds_bus{0};                ///< of a sensor: so long at a time, and the time of its transfers
  /// Compares the part with what the topics that it uses carry, once all parts are known. `payload_of`: null where that
  /// is not known before their parts are made. Empty: there is nothing to compare.
  using PayloadOf = std::function<const Description*(std::string_view topic)>;
  std::function<void(const PartPlan& part, const PayloadOf& payload_of, Problems& problems)> check_topics = {};
  /// Why it cannot be set to a value, of an output. Empty text: it can. Empty: it is none, or its item has mistakes.
  std::function<std::string(double value)> refusal = {};
  /// Makes it on the loop of the tier that it names, or else on the main loop. Empty: the item has mistakes. On a tier
  /// that runs it is given up when it does not come back for 1 s, and what it makes then is closed: it looks at `parts`
  /// before it does anything that may block.
  using Make = std::function<PartObject(Loop& loop, const Parts& parts)>;
  Make make = {};
  /// Returns what makes it in the place of the one before, of its kind and name, which is closed after this call and
  /// before it is made: a machine goes on in its state. Empty: as `make`.
  std::function<Make(const PartObject& before)> make_again = {};

  /// Of one that was made without waiting for its device (Parts::takes): calls `done` on the part's loop, in a later
  /// turn, when that has come to an end. Empty: making it waits.
  std::function<void(const PartObject& part, std::function<void(Result<void>)> done)> when_made = {};
  /// Begins what closing it waits for, such as a slow device, so that the loop turns meanwhile; `done` is called on the
  /// part's loop, in a later turn. Empty: nothing.
  std::function<void(const PartObject& part, std::function<void()> done)> ending = {};

  /// The keys of the item that can change while the part runs, each with the function that applies the new value, which
  /// is the one in the plan that the function is taken from. A change of any other key makes the part anew. A function
  /// may throw SetupError: then that of the old plan is called, which applies the old value again.
  std::map<std::string, std::function<void(const PartObject& part)>, std::less<>> live = {};

  /// What is done when it is removed and none is made in its place, before it is closed: a machine leaves what it set
  /// safe. May throw SetupError: it stays. Empty: nothing.
  std::function<void(const PartObject& part)> on_removal = {};
  /// What a command changes until the next reload: applies what the plan says. Called after each one that leaves the
  /// part running. May throw SetupError, which is logged. Empty: nothing.
  std::function<void(const PartObject& part)> as_written = {};

  /// While this is so, a reload neither makes the part anew nor removes it: an output that is armed.
  struct Hold {
    std::string what;    ///< "it is armed"
    std::string advice;  ///< "disarm it first"
    std::function<bool(const PartObject& part)> is_so;
  };
  std::optional<Hold> hold = {};

  /// The tier that it runs on; empty: the main loop.
  std::string_view tier() const noexcept;
  /// "sensor chamber"
  std::string object() const { return kind + " " + name; }
};

/// The parts of a system that are made.
class Parts {
 public:
  Parts() = default;
  Parts(const Parts&) = delete;
  Parts& operator=(const Parts&) = delete;
  ~Parts();

  /// The part as what its factory returned, or as the base of its kind (AnySensor, Sink, Tier). Valid until it is
  /// removed. SetupError: there is none of that name (not-found, with the nearest); it is no T (bad-argument).
  template <class T>
  T& get(std::string_view kind, std::string_view name) const {
    if (T* object = part_named(kind, name).object.as<T>()) return *object;
    refuse_type(kind, name);
  }
  /// Null: there is none of that name, or it is no T.
  template <class T>
  T* find(std::string_view kind, std::string_view name) const {
    const auto found = by_name_.find({std::string(kind), std::string(name)});
    return found == by_name_.end() ? nullptr : found->second->object.as<T>();
  }
  /// In the order in which they were made.
  std::vector<std::string> names(std::string_view kind) const;
  /// How what is made takes its device. Not at once: `PartPlan::when_made` tells.
  Output::Takes takes() const noexcept { return takes_; }
  /// The plans of all parts, in that order. Valid until the system changes.
  std::vector<const PartPlan*> plans() const;

 private:
  friend class System;
  friend class config_detail::PlanApplication;
  struct Part {
    PartPlan plan;
    PartObject object;
  };
  Part& part_named(std::string_view kind, std::string_view name) const;
  [[noreturn]] void refuse_type(std::string_view kind, std::string_view name) const;
  void add(std::unique_ptr<Part> part);
  std::unique_ptr<Part> take(std::string_view kind, std::string_view name);

  std::vector<std::unique_ptr<Part>> made_;
  std::map<std::pair<std::string, std::string>, Part*> by_name_;
  Output::Takes takes_ = Output::Takes::at_once;
};

}  // namespace rtdata
