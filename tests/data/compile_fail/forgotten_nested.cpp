// expect: `describe` leaves out a member of the struct
// lines: 32
#include "rtdata/data/describe.hpp"

struct Point {
  double x = 0;
  double y = 0;
  RTDATA_FIELDS(Point, (x))
};
struct Track {
  std::array<Point, 3> points{};
  RTDATA_FIELDS(Track, (points))
};

const auto& description = rtdata::description_of<Track>();
