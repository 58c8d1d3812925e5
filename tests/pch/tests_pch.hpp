// Precompiled for the tests by g++ (RTDATA_PCH; meson: b_pch). Each file still includes what it uses: the builds
// without this header prove it. Not more than what most tests include: a larger one costs g++ more than it saves.
#include <doctest/doctest.h>

#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
