// Whether a sanitizer looks on, under which all takes several times as long: what is tried again and again with other
// seeds is tried less often then.
#pragma once

namespace rtdata::test {

#if defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define RTDATA_TEST_THREAD_SANITIZED true
#endif
#if __has_feature(address_sanitizer)
#define RTDATA_TEST_ADDRESS_SANITIZED true
#endif
#endif
#ifndef RTDATA_TEST_THREAD_SANITIZED
#define RTDATA_TEST_THREAD_SANITIZED false
#endif
#ifndef RTDATA_TEST_ADDRESS_SANITIZED
#define RTDATA_TEST_ADDRESS_SANITIZED false
#endif
constexpr bool thread_sanitized = RTDATA_TEST_THREAD_SANITIZED;
constexpr bool sanitized = thread_sanitized || RTDATA_TEST_ADDRESS_SANITIZED;
#undef RTDATA_TEST_THREAD_SANITIZED
#undef RTDATA_TEST_ADDRESS_SANITIZED

}  // namespace rtdata::test
