// The course of a recorded run: notes, commands, alarms, changes of state.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/value.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::app {

struct CourseEvent {
  Time time{};         ///< as recorded
  std::string object;  ///< the limit or machine; of a note or command, who gave it
  std::string text;    ///< readable, without the object
  std::vector<std::pair<std::string, Value>> values;
};

/// In order of time; the first 1000.
struct CourseEvents {
  std::vector<CourseEvent> first;
  std::uint64_t count = 0;  ///< of all
};

struct Course {
  CourseEvents notes, commands, alarms, states;
};

/// True if events of this payload are part of it.
bool is_of_course(const Description& description);

/// `topics`: all of the recording; their payloads show which ones are relevant.
Course course_of(const Recording& recording, const std::vector<RecordedTopic>& topics, std::int64_t run);

}  // namespace rtdata::app
