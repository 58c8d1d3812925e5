# The examples: each is built as example_NAME into examples/ of the build tree and run in a fresh folder.
function(rtdata_example_test name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "FOLDER" "COMMAND")
  if(NOT arg_FOLDER)
    set(arg_FOLDER ${name})
  endif()
  set(folder ${CMAKE_CURRENT_BINARY_DIR}/examples/run/${arg_FOLDER})
  file(MAKE_DIRECTORY ${folder})  # ctest changes into it before the command makes it fresh
  add_test(NAME example_${name} COMMAND ${arg_COMMAND} WORKING_DIRECTORY ${folder})
  set_tests_properties(example_${name} PROPERTIES TIMEOUT 300 LABELS example)
endfunction()

# A fixture that empties the folder of an example.
function(rtdata_fresh_folder name)
  set(folder ${CMAKE_CURRENT_BINARY_DIR}/examples/run/${name})
  add_test(NAME example_${name}_folder COMMAND sh -c "rm -rf '${folder}' && mkdir -p '${folder}'")
  set_tests_properties(example_${name}_folder PROPERTIES FIXTURES_SETUP folder_${name} LABELS example)
  set_property(TEST example_${name} APPEND PROPERTY FIXTURES_REQUIRED folder_${name})
endfunction()

rtdata_sources(RTDATA_EXAMPLES examples/examples.sources SINGLY)
set(example_source_dir ${CMAKE_CURRENT_SOURCE_DIR}/examples)
foreach(source ${RTDATA_EXAMPLES})
  get_filename_component(name ${source} NAME_WE)
  file(STRINGS ${CMAKE_CURRENT_SOURCE_DIR}/${source} includes REGEX "^#include")
  if("${includes}" MATCHES "rtdata/recording/" AND NOT TARGET rtdata_sqlite)
    continue()
  endif()
  if("${includes}" MATCHES "rtdata/app/" AND NOT TARGET rtdata_program)
    continue()
  endif()
  add_executable(example_${name} ${source})
  set_target_properties(example_${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
  target_link_libraries(example_${name} PRIVATE rtdata_options rtdata::rtdata $<TARGET_NAME_IF_EXISTS:rtdata::sqlite>
    $<TARGET_NAME_IF_EXISTS:rtdata::program> PkgConfig::libuv)
  set(arguments "")
  if(name STREQUAL "06_own_types_in_json")
    set(arguments run ${example_source_dir}/06_own_types.json --for 500ms)
  endif()
  if(name STREQUAL "rocket")
    if(TARGET rtdata_main)  # imports the simulated flight
      rtdata_example_test(rocket COMMAND sh -c "$<TARGET_FILE:rtdata_main> import ${example_source_dir}/rocket/flight.csv --time t --topic rocket \\
        --origin rocket --into flight.db && $<TARGET_FILE:example_rocket>")
      rtdata_fresh_folder(rocket)
    endif()
    continue()
  endif()
  rtdata_example_test(${name} COMMAND example_${name} ${arguments})
  rtdata_fresh_folder(${name})
endforeach()

if(TARGET example_analysis AND TARGET rtdata_main)
  add_dependencies(rtdata_tests example_analysis)  # tests/app/fleet_example_test.cpp, of the program, runs it
endif()

find_package(Python3 COMPONENTS Interpreter QUIET)
if(Python3_FOUND AND TARGET example_01_record)  # reads what 01 has recorded, in the folder of 01
  rtdata_example_test(08_read_with_python FOLDER 01_record
    COMMAND ${Python3_EXECUTABLE} ${example_source_dir}/08_read_with_python.py run.db load)
  set_tests_properties(example_01_record PROPERTIES FIXTURES_SETUP recording_of_01)
  set_tests_properties(example_08_read_with_python PROPERTIES FIXTURES_REQUIRED recording_of_01)
endif()
if(TARGET rtdata_main AND TARGET rtdata_sqlite)
  rtdata_example_test(host COMMAND rtdata_main run ${example_source_dir}/host.json --for 1s)
  rtdata_fresh_folder(host)
  rtdata_example_test(gps COMMAND rtdata_main run ${example_source_dir}/gps.json --for 500ms)  # also without gpsd
  rtdata_fresh_folder(gps)
  foreach(name bench weather rocket_sensors)  # the last two run in the kernel bench: tests/kernel/examples_test.cpp
    rtdata_example_test(${name} COMMAND rtdata_main check ${example_source_dir}/${name}.json)
  endforeach()
endif()
