// expect: `describe` leaves out a member of the struct
#include "rtdata/data/describe.hpp"

struct Point {
  double x = 0;
  double y = 0;
  RTDATA_FIELDS(Point, (x), (y))
};
struct Track {
  std::array<Point, 3> points{};
  std::optional<double> speed;
  rtdata::text<8> name;
  Point last;
  std::optional<int> forgotten;
  RTDATA_FIELDS(Track, (points), (speed), (name), (last))
};

const auto& description = rtdata::description_of<Track>();
