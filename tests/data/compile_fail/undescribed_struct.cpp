// expect: a field is a struct without a `describe`
#include "rtdata/data/describe.hpp"

struct Point {
  double x = 0;
};
struct Track {
  std::array<Point, 2> points{};
  RTDATA_FIELDS(Track, (points))
};

const auto& description = rtdata::description_of<Track>();
