#include "rtdata/detail/io/loaded_library.hpp"

#include <doctest/doctest.h>

#include <string>
#include <thread>
#include <vector>

using namespace rtdata;
using detail::LoadedFunction;
using detail::LoadedLibrary;

namespace {

LoadedFunction<double (*)(double)> cosine;
LoadedFunction<double (*)(double)> no_function;
constexpr LoadedLibrary::Function of_libm[] = {{"cos", &cosine.address}};
constexpr LoadedLibrary::Function not_of_libm[] = {{"cos", &cosine.address}, {"rtdata_none", &no_function.address}};
constexpr const char* no_library[] = {"librtdata-none.so.7"};
constexpr const char* second_is_there[] = {"librtdata-none.so.7", "libm.so.6"};

}  // namespace

TEST_SUITE("data") {
  TEST_CASE("NFR-5 a library that is not there is told with its file, its name and its package, again and again") {
    LoadedLibrary library("type fancy", "libfancy", "libfancy7", no_library, of_libm);
    for (int i = 0; i < 2; ++i) {
      const auto loaded = library.load();
      REQUIRE_FALSE(loaded);
      CHECK(loaded.error().id() == "not-found");
      CHECK(loaded.error().text() ==
            "type fancy: libfancy is not installed (librtdata-none.so.7: cannot open shared object file: No such file "
            "or directory): apt install libfancy7");
    }
  }

  TEST_CASE("a library is loaded under the first of its names that is there, once, by whoever comes first") {
    LoadedLibrary library("type cosine", "libm", "libc6", second_is_there, of_libm);
    std::vector<std::thread> threads;
    for (int i = 0; i < 4; ++i) {
      threads.emplace_back([&] {
        if (library.load()) CHECK(cosine(0) == 1);
      });
    }
    for (std::thread& thread : threads) thread.join();
    CHECK(library.load());
    CHECK(cosine(0) == 1);
  }

  TEST_CASE("NFR-5 a library that lacks a function is told with the function") {
    LoadedLibrary library("type cosine", "libm", "libc6", second_is_there, not_of_libm);
    const auto loaded = library.load();
    REQUIRE_FALSE(loaded);
    CHECK(loaded.error().text() ==
          "type cosine: libm is older than the version that this program was built with: it has no function "
          "rtdata_none: apt install libc6");
  }
}
