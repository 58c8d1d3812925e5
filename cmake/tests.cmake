# One test program, one doctest suite a folder; ctest runs each suite, or a part of it, in a process of its own.
find_package(doctest REQUIRED)
set(RTDATA_TEST_SUITES data loop process sensors sinks fsm outputs control config app contract CACHE STRING
  "The folders of tests that are built, for those who run some of them only")
rtdata_sources(RTDATA_TEST_SOURCES tests/tests.sources)
list(JOIN RTDATA_TEST_SUITES "|" built)
foreach(unit IN LISTS RTDATA_TEST_SOURCES)
  set(files ${unit})
  if(IS_ABSOLUTE ${unit})
    file(STRINGS ${unit} files)
  endif()
  if(NOT "${files}" MATCHES "(${built})/" AND NOT "${files}" MATCHES "(main|_kinds|power_cut)\\.cpp")  # which are no tests
    list(REMOVE_ITEM RTDATA_TEST_SOURCES ${unit})
  endif()
endforeach()
add_library(rtdata_test_paths STATIC tests/paths.cpp)
target_link_libraries(rtdata_test_paths PRIVATE rtdata_options)
target_compile_definitions(rtdata_test_paths PRIVATE RTDATA_SOURCE_DIR="${CMAKE_CURRENT_SOURCE_DIR}"
  RTDATA_BINARY_DIR="${CMAKE_CURRENT_BINARY_DIR}")
# Optimizing them takes longer than running them. What inlines templates of public headers as users do is optimized: the
# examples, the allocation and fault tests.
add_library(rtdata_test_options INTERFACE)
target_compile_options(rtdata_test_options INTERFACE $<$<CONFIG:Release>:-O0>)
add_executable(rtdata_tests ${RTDATA_TEST_SOURCES})
target_link_libraries(rtdata_tests PRIVATE rtdata_options rtdata_test_options rtdata_test_paths rtdata::rtdata doctest::doctest PkgConfig::libuv
  nlohmann_json::nlohmann_json $<TARGET_NAME_IF_EXISTS:rtdata::program> rtdata::sqlite PkgConfig::sqlite3
  $<TARGET_NAME_IF_EXISTS:rtdata::modbus> $<TARGET_NAME_IF_EXISTS:rtdata::http> $<TARGET_NAME_IF_EXISTS:rtdata::mqtt>
  # The libraries alone: their folders of headers are told to what includes them, below.
  ${RTDATA_MODBUS_LINK_LIBRARIES} ${RTDATA_MQTT_LINK_LIBRARIES} ${RTDATA_HTTP_LINK_LIBRARIES})
set_source_files_properties(tests/sensors/modbus_test.cpp PROPERTIES INCLUDE_DIRECTORIES "${RTDATA_MODBUS_INCLUDE_DIRS}")
target_include_directories(rtdata_tests PRIVATE tests src)
if(RTDATA_SANITIZE)  # hours of flights, computed in headers of an example
  foreach(unit IN LISTS RTDATA_TEST_SOURCES)
    if(EXISTS ${unit})
      file(STRINGS ${unit} rockets REGEX "app/rocket_|\"rocket/")
      if(rockets)
        set_source_files_properties(${unit} PROPERTIES COMPILE_OPTIONS -O1)
      endif()
    endif()
  endforeach()
endif()
target_compile_definitions(rtdata_tests PRIVATE DOCTEST_CONFIG_USE_STD_HEADERS)
if(TARGET rtdata_postgresql)
  rtdata_sources(RTDATA_POSTGRESQL_TEST_SOURCES tests/postgresql_tests.sources)
  target_sources(rtdata_tests PRIVATE ${RTDATA_POSTGRESQL_TEST_SOURCES})
  target_link_libraries(rtdata_tests PRIVATE rtdata::postgresql ${RTDATA_POSTGRESQL_LINK_LIBRARIES})
  set_source_files_properties(${RTDATA_POSTGRESQL_TEST_SOURCES} PROPERTIES INCLUDE_DIRECTORIES "${RTDATA_POSTGRESQL_INCLUDE_DIRS}")
endif()
if(RTDATA_PCH)
  target_precompile_headers(rtdata_tests PRIVATE <pch/tests_pch.hpp>)  # in <>: no path of this clone gets into the file
  set_source_files_properties(tests/main.cpp PROPERTIES SKIP_PRECOMPILE_HEADERS ON)  # configures doctest before including it
endif()
if(RTDATA_PROGRAM)
  # The program as the tests run it, with sensor and sink types of their own.
  add_executable(rtdata_test_program tests/app/test_program.cpp)
  target_link_libraries(rtdata_test_program PRIVATE rtdata_options rtdata::program)
  target_include_directories(rtdata_test_program PRIVATE tests)
  add_dependencies(rtdata_tests rtdata_test_program rtdata_main)
endif()
# The longest begin first, and the two longest are two tests each, which run beside each other.
set(examples_of_app --source-file=*/app/rocket*,*/app/test_bench*,*/app/fleet_example*,*/app/many_machines*)
set(network_of_sinks --source-file=*/sinks/*http*,*/sinks/*mqtt*,*/sinks/*postgresql*,*/sinks/*network*,*/sinks/*tcp*,*/sinks/*sender*,*/sinks/*through*,*/sinks/half_open*,*/sinks/slow_peer*)
set(suites ${RTDATA_TEST_SUITES})
list(REMOVE_ITEM suites control)  # which has tests of the suite `outputs`
foreach(suite IN LISTS suites)
  set(all_but_part "")
  foreach(part examples network)
    if(DEFINED ${part}_of_${suite})
      string(REPLACE --source-file= --source-file-exclude= all_but_part "${${part}_of_${suite}}")
      add_test(NAME ${suite}_${part} COMMAND rtdata_tests --test-suite=${suite} ${${part}_of_${suite}} --no-skipped-summary)
      set_tests_properties(${suite}_${part} PROPERTIES COST 200)
    endif()
  endforeach()
  add_test(NAME ${suite} COMMAND rtdata_tests --test-suite=${suite} ${all_but_part} --no-skipped-summary)
  if(suite MATCHES "^(app|sinks|sensors|config)$")
    set_tests_properties(${suite} PROPERTIES COST 100)
  endif()
endforeach()

# Run by script/test --all in the kernel bench, with real drivers.
if(RTDATA_PROGRAM)
  rtdata_sources(RTDATA_KERNEL_TEST_SOURCES tests/kernel/kernel_tests.sources SINGLY)
  add_executable(rtdata_kernel_tests ${RTDATA_KERNEL_TEST_SOURCES})
  target_link_libraries(rtdata_kernel_tests PRIVATE rtdata_options rtdata_test_options rtdata_test_paths rtdata::program doctest::doctest PkgConfig::sqlite3)
  target_include_directories(rtdata_kernel_tests PRIVATE tests src)
  target_compile_definitions(rtdata_kernel_tests PRIVATE DOCTEST_CONFIG_USE_STD_HEADERS)
  add_dependencies(rtdata_kernel_tests rtdata_main)
endif()

# A program of their own, small enough to be built on another system with another libgpiod (tests/bare/run.sh).
if(TARGET rtdata_gpio)
  rtdata_sources(RTDATA_KERNEL_GPIO_TEST_SOURCES tests/kernel/kernel_gpio_tests.sources SINGLY)
  add_executable(rtdata_kernel_gpio_tests ${RTDATA_KERNEL_GPIO_TEST_SOURCES})
  target_link_libraries(rtdata_kernel_gpio_tests PRIVATE rtdata_options rtdata_test_options rtdata::gpio doctest::doctest)
  target_include_directories(rtdata_kernel_gpio_tests PRIVATE tests src)
  target_compile_definitions(rtdata_kernel_gpio_tests PRIVATE DOCTEST_CONFIG_USE_STD_HEADERS)
endif()

# Replaces operator new and delete, so it is a program of its own; the sanitizers replace them too.
if(NOT RTDATA_SANITIZE)
  add_executable(rtdata_allocation_tests tests/loop/allocation_test.cpp)
  target_link_libraries(rtdata_allocation_tests PRIVATE rtdata_options rtdata::rtdata doctest::doctest)
  target_include_directories(rtdata_allocation_tests PRIVATE tests)
  target_compile_definitions(rtdata_allocation_tests PRIVATE DOCTEST_CONFIG_USE_STD_HEADERS)
  add_test(NAME allocation COMMAND rtdata_allocation_tests)
  add_executable(rtdata_fault_tests tests/faults/faults_test.cpp)
  target_link_libraries(rtdata_fault_tests PRIVATE rtdata_options rtdata::sqlite doctest::doctest PkgConfig::sqlite3)
  target_compile_definitions(rtdata_fault_tests PRIVATE DOCTEST_CONFIG_USE_STD_HEADERS)
  add_test(NAME faults COMMAND rtdata_fault_tests)
  set_tests_properties(faults PROPERTIES TIMEOUT 900)
endif()

# Files that must not compile, each with one sentence.
find_package(Python3 COMPONENTS Interpreter)
if(Python3_FOUND)
  add_test(NAME compile_fail COMMAND ${Python3_EXECUTABLE} ${CMAKE_CURRENT_SOURCE_DIR}/tests/data/compile_fail.py
    ${CMAKE_CXX_COMPILER} ${CMAKE_CURRENT_SOURCE_DIR}/include)
endif()

# The JSON Schema and `rtdata check` hold each other.
if(Python3_FOUND AND TARGET rtdata_main)
  add_test(NAME schema COMMAND ${Python3_EXECUTABLE} ${CMAKE_CURRENT_SOURCE_DIR}/tests/config/schema_test.py
    $<TARGET_FILE:rtdata_main> ${CMAKE_CURRENT_SOURCE_DIR})
  set_tests_properties(schema PROPERTIES TIMEOUT 900 SKIP_RETURN_CODE 77)
endif()

# The live page in a browser, where there is one, of the program that users get.
if(RTDATA_HAS_PAGE AND TARGET rtdata_main AND NOT RTDATA_SANITIZE)
  add_test(NAME page COMMAND sh ${CMAKE_CURRENT_SOURCE_DIR}/tests/browser/run.sh $<TARGET_FILE:rtdata_main>)
  set_tests_properties(page PROPERTIES TIMEOUT 900 SKIP_RETURN_CODE 77)
endif()

include(cmake/examples.cmake)

# The documentation agrees with the product.
if(Python3_FOUND)
  add_test(NAME docs COMMAND ${Python3_EXECUTABLE} ${CMAKE_CURRENT_SOURCE_DIR}/tests/docs/docs_test.py
    ${CMAKE_CURRENT_SOURCE_DIR} ${CMAKE_CURRENT_BINARY_DIR} ${CMAKE_CXX_COMPILER})
  set_tests_properties(docs PROPERTIES TIMEOUT 900)
endif()

# The recipes give the values of their pages.
if(Python3_FOUND AND TARGET rtdata_main)
  add_test(NAME recipes COMMAND ${Python3_EXECUTABLE} ${CMAKE_CURRENT_SOURCE_DIR}/tests/docs/recipes_test.py
    ${CMAKE_CURRENT_SOURCE_DIR} $<TARGET_FILE:rtdata_main>)
  set_tests_properties(recipes PROPERTIES TIMEOUT 900 SKIP_RETURN_CODE 77)
endif()

# Projects of others find and use what is installed. Sanitized libraries would want sanitized users.
if(NOT RTDATA_SANITIZE)
  add_test(NAME install COMMAND sh ${CMAKE_CURRENT_SOURCE_DIR}/tests/install/install_test.sh
    ${CMAKE_CURRENT_BINARY_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  set_tests_properties(install PROPERTIES TIMEOUT 900 LABELS slow ENVIRONMENT "CXX=${CMAKE_CXX_COMPILER}")
endif()
