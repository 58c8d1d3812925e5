// expect nothing: the same shape as the files that fail, without a mistake
#include <string>

#include "rtdata/data/event.hpp"

enum class State { idle, running };
constexpr auto describe(rtdata::type_tag<State>) {
  return rtdata::enumeration("state", rtdata::value("idle", State::idle), rtdata::value("running", State::running));
}
struct Point {
  double x = 0;
  double y = 0;
  RTDATA_FIELDS(Point, (x, "m"), (y, "m"))
};
struct Track {
  std::array<Point, 3> points{};
  std::optional<double> speed;
  rtdata::text<8> name;
  Point last;
  std::optional<State> state;
  RTDATA_FIELDS(Track, (points), (speed), (name), (last), (state))
};

const auto& description = rtdata::description_of<Track>();
// A payload without a description can be published, so its event and its view of others must compile.
const rtdata::Event<std::string> undescribed;
static_assert(!rtdata::Described<std::string>);
