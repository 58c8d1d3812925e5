// Whether a sanitizer looks on, under which all takes several times as long: what is tried again and again with other
// seeds is tried less often then.
#pragma once

namespace rtdata::test {

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define RTDATA_TEST_SANITIZED true
#endif
#endif
#ifndef RTDATA_TEST_SANITIZED
#define RTDATA_TEST_SANITIZED false
#endif
constexpr bool sanitized = RTDATA_TEST_SANITIZED;
#undef RTDATA_TEST_SANITIZED

}  // namespace rtdata::test
