#include "rtdata/data/error.hpp"

#include <doctest/doctest.h>

#include <cerrno>
#include <stdexcept>
#include <string>

using namespace rtdata;

TEST_SUITE("data") {
  TEST_CASE("an error reads what: where: why: advice, without its empty parts") {
    const Error full{Errc::not_found, "cannot open", "/dev/x", "No such file", "plug it in"};
    CHECK(full.text() == "cannot open: /dev/x: No such file: plug it in");
    const Error brief{Errc::closed, "closed", "", "", ""};
    CHECK(brief.text() == "closed");
    CHECK(full.id() == "not-found");
    CHECK(full.text_with_id() == "cannot open: /dev/x: No such file: plug it in [not-found]");
  }

  TEST_CASE("what is thrown ends with its id, and as the reason of another error it does not") {
    const SetupError refused({Errc::busy, "cannot open", "x", "", ""});
    CHECK(std::string(refused.what()) == "cannot open: x [busy]");
    CHECK(detail::reason_of(refused) == "cannot open: x");
    CHECK(detail::reason_of(std::runtime_error("x [busy]")) == "x [busy]");
    CHECK(detail::with_id("text", "") == "text");
  }

  TEST_CASE("every error code has an id of its own") {
    std::string all;
    for (int i = 0; i <= static_cast<int>(Errc::closed); ++i) {
      const auto text = std::string(id(static_cast<Errc>(i)));
      CHECK(text != "unknown");
      CHECK(all.find("," + text + ",") == std::string::npos);
      all += "," + text + ",";
    }
  }

  TEST_CASE("errno becomes the code that fits it, with its text as the why") {
    CHECK(system_error(ENOSPC, "write", "f").code == Errc::storage_full);
    CHECK(system_error(EACCES, "open", "f").code == Errc::not_permitted);
    CHECK(system_error(ENOENT, "open", "f").why == "No such file or directory");
  }

  TEST_CASE("a failed result throws its error only when asked to") {
    Result<int> bad = Error{Errc::bad_data, "no", "", "", ""};
    CHECK_FALSE(bad);
    CHECK_THROWS_WITH_AS(bad.or_throw(), "no [bad-data]", SetupError);
    Result<int> good = 3;
    CHECK(good.or_throw() == 3);
    CHECK_NOTHROW(Result<void>().or_throw());
    // The value outlives a temporary result, so that it can be looped over.
    static_assert(std::is_same_v<decltype(Result<std::string>("").or_throw()), std::string>);
  }
}
