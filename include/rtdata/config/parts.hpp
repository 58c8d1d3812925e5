/// Parts: the tiers, buses, sinks, sensors and other objects that a configuration lists and a system consists of.
///
/// A `PartPlan` is a part that was checked but not made yet. It knows its name, the parts that it uses and how to make
/// it. A part is made after the parts that it uses and closed before them; otherwise tiers are made first, then buses,
/// sinks and sensors, and closed in reverse order. `Parts` holds the parts that were made.
///
/// Plans are values; any thread. Parts: owned by the System, used on the main loop's thread; while a part is made on a
/// tier, the tier's thread may read them.
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

/// Owns the object of a part, of any type. Destroying it closes the part. Move-only; empty by default and after a move.
class PartObject {
 public:
  PartObject() noexcept = default;
  /// Holds what `make()` returns, which need not be movable. `get` returns it as its own type or as a Base.
  template <class Base, class Make>
  static PartObject made_by(Make&& make) {
    PartObject object;
    object.holder_ = std::make_unique<HolderOf<Base, std::invoke_result_t<Make&>>>(make);
    return object;
  }

  /// Null if it is not a T.
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

/// A reference to another part, by a parameter declared with `names_part` (parameter.hpp).
struct PartUse {
  std::string kind;  ///< "bus"; "topic": any part that publishes it
  std::string name;
  std::vector<std::string> types;  ///< allowed types of the other part; empty: any
  ConfigItem item;                 ///< the item with the name
};

/// A device's own sampling; 0: unknown, or it has none.
struct Sampling {
  double hertz = 0;          ///< samples a second that the device takes by itself
  std::size_t kept = 0;      ///< samples that its FIFO holds until they are read
  Duration reading_time{0};  ///< minimum duration of a reading
};

/// A topic that a part publishes, as far as known before the part is made.
struct PublishedTopic {
  std::string topic;                               ///< never empty
  std::shared_ptr<const Description> description;  ///< null: known only after the part is made
  std::optional<SensorLoad> load;                  ///< null: no reading, the program feeds it
  Sampling sampling = {};
  /// The fields that expressions may use, if they differ from the description: a machine also has its states. Null:
  /// unknown.
  std::optional<std::shared_ptr<const Description>> in_expressions = {};
};

/// The topics that a part stores, and where.
struct StoredTopics {
  std::vector<std::string> topics;
  std::string path;             ///< the file it writes; "-" for standard output, empty for none
  Duration close_deadline{0};   ///< limit for closing it
  bool is_recording = false;    ///< other sinks can go through it
  bool is_sender = false;       ///< its peer is across a network
  std::string through = {};     ///< the recording that it reads from; empty: none
  Duration batch_time{0};       ///< longest wait of an event until it is stored, without failures
  std::size_t queue_bytes = 0;  ///< maximum memory for queued events
  /// Returns an error for each topic that the part cannot store. Empty function: not known before it is made.
  std::function<std::vector<Error>(std::span<const TopicToRecord>)> refused_topics = {};
  /// The file that a topic's events go to; empty: all go to `path`.
  std::function<std::string(std::string_view topic)> file_of_topic = {};
  /// Returns true if the part creates, renames or removes `other` as a companion of `file`, which it writes (a log, a
  /// lock); both paths are absolute. Empty function: it has no companion files.
  std::function<bool(const std::string& file, const std::string& other)> is_companion_file = {};
  /// Checks that a file which the part writes can be opened and locked now, whether it exists or not; creates and
  /// changes nothing. Any thread; blocks on the disk. Errors: busy (another process writes it). Empty function: not
  /// known before it is made.
  std::function<Result<void>(const std::string& file)> check_openable = {};

  bool wants(std::string_view topic) const noexcept;
};

struct PartPlan {
  std::string kind;  ///< "tier", "bus", "sink", "sensor"
  std::string type;  ///< empty for a tier
  std::string name;
  ConfigItem item;  ///< the item of the configuration
  std::vector<PartUse> uses = {};
  std::vector<std::string> secrets = {};  ///< texts of the item that must never be shown
  std::optional<PublishedTopic> publishes = {};
  std::optional<StoredTopics> stores = {};
  std::string passes_on = {};  ///< the topic whose events it republishes on its own topic; empty: none
  std::string stored_by = {};  ///< the sink that must store its events; empty: any
  /// The place that the part reserves: on a bus, or a device of the machine.
  struct Place {
    std::string bus = {};              ///< empty: it is not on a bus
    std::string text = {};             ///< "address 0x76"; without a bus "/dev/i2c-1"; empty: none
    std::string advice = {};           ///< advice for a second user of the place; empty: use another place
    std::string bus_type = {};         ///< type of bus with such places; empty: any type that the part allows
    std::string advice_on_other = {};  ///< advice for a bus of another type
    std::string more = {};             ///< further identity that is never shown, such as the path of a URL
    std::string sharing = {};          ///< parts of one tier with the same text may use the place together; empty: none
  } place = {};
  std::vector<Place> more_places = {};  ///< further places, if the part takes several
  Duration give_up_after{0};            ///< of a bus: limit of a sensor's job; 0: unknown
  Duration holds_bus{0};                ///< of a sensor: longest time on the bus at once, besides its transfers
  /// Checks the part against the payloads of the topics that it uses, once all parts are known. `payload_of` returns
  /// null if a payload is not known before its part is made. Empty function: nothing to check.
  using PayloadOf = std::function<const Description*(std::string_view topic)>;
  std::function<void(const PartPlan& part, const PayloadOf& payload_of, Problems& problems)> check_topics = {};
  /// Of an output: returns why it cannot be set to a value; an empty text means that it can. Empty function: not an
  /// output, or the item has mistakes.
  std::function<std::string(double value)> refusal = {};
  /// Makes the part on the loop of its tier, or on the main loop. Empty function: the item has mistakes. On a running
  /// tier the call is given up after 1 s, and its late result is closed; so it must read `parts` before it does
  /// anything that may block.
  using Make = std::function<PartObject(Loop& loop, const Parts& parts)>;
  Make make = {};
  /// Returns a function that makes the part as the successor of `before`, which has the same kind and name and is
  /// closed in between: a machine keeps its state this way. Empty function: use `make`.
  std::function<Make(const PartObject& before)> make_again = {};

  /// For a part that was made without waiting for its device (Parts::takes): calls `done` with the result on the part's
  /// loop, in a later turn. Empty function: `make` waits for the device.
  std::function<void(const PartObject& part, std::function<void(Result<void>)> done)> when_made = {};
  /// Begins the slow work of closing, such as releasing a device, while the loop turns; calls `done` on the part's
  /// loop, in a later turn. Empty function: nothing to wait for.
  std::function<void(const PartObject& part, std::function<void()> done)> ending = {};

  /// The keys that can change while the part runs, each with a function that applies the value of this plan. A change
  /// of any other key restarts the part. If a function throws SetupError, the function of the old plan is called to
  /// restore the old value.
  std::map<std::string, std::function<void(const PartObject& part)>, std::less<>> live = {};

  /// Called before the part is closed when it is removed without a successor: a machine sets its outputs safe. If it
  /// throws SetupError, the part stays. Empty function: nothing to do.
  std::function<void(const PartObject& part)> on_removal = {};
  /// Restores the values of the plan that a command may have changed. Called after each reload that leaves the part
  /// running. A SetupError is logged. Empty function: nothing to restore.
  std::function<void(const PartObject& part)> as_written = {};

  /// A reason why a reload must not restart or remove the part now: for example, an armed output.
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

  /// The part as the type that its factory returned, or as the base of its kind (AnySensor, Sink, Tier). Valid until it
  /// is removed. SetupError: not-found (no such name; with the nearest one), bad-argument (it is not a T).
  template <class T>
  T& get(std::string_view kind, std::string_view name) const {
    if (T* object = part_named(kind, name).object.as<T>()) return *object;
    refuse_type(kind, name);
  }
  /// Null: no part of that name, or it is not a T.
  template <class T>
  T* find(std::string_view kind, std::string_view name) const {
    const auto found = by_name_.find({std::string(kind), std::string(name)});
    return found == by_name_.end() ? nullptr : found->second->object.as<T>();
  }
  /// In the order in which they were made.
  std::vector<std::string> names(std::string_view kind) const;
  /// How new outputs open their devices. If not at once, `PartPlan::when_made` reports the result.
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
