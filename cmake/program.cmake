# The program `rtdata`, and what it is made of as a library for programs with types of their own.
find_package(CLI11 REQUIRED)
find_package(spdlog REQUIRED)
rtdata_sources(RTDATA_PROGRAM_SOURCES src/rtdata_program.sources)
rtdata_library(rtdata_program program ${RTDATA_PROGRAM_SOURCES})
# None of it runs while sampling: small rather than fast.
target_compile_options(rtdata_program PRIVATE $<$<CONFIG:Release>:-Os>)
target_link_libraries(rtdata_program PUBLIC rtdata PRIVATE $<BUILD_INTERFACE:CLI11::CLI11> spdlog::spdlog
  $<TARGET_NAME_IF_EXISTS:rtdata::sqlite> $<$<BOOL:${sqlite3_FOUND}>:PkgConfig::sqlite3> $<BUILD_INTERFACE:nlohmann_json::nlohmann_json>)
if(TARGET rtdata_sqlite)
  target_compile_definitions(rtdata_program PRIVATE RTDATA_WITH_SQLITE)
  rtdata_sources(RTDATA_PROGRAM_SQLITE_SOURCES src/rtdata_program_sqlite.sources)
  target_sources(rtdata_program PRIVATE ${RTDATA_PROGRAM_SQLITE_SOURCES})
endif()
if(TARGET rtdata_modbus)
  target_compile_definitions(rtdata_program PRIVATE RTDATA_WITH_MODBUS)
  target_link_libraries(rtdata_program PRIVATE rtdata::modbus)
endif()
set_property(SOURCE src/app/core/program.cpp APPEND PROPERTY COMPILE_DEFINITIONS RTDATA_VERSION="${PROJECT_VERSION}")

add_executable(rtdata_main src/app/main.cpp)
set_target_properties(rtdata_main PROPERTIES OUTPUT_NAME rtdata)
target_link_libraries(rtdata_main PRIVATE rtdata_options rtdata::program)
install(TARGETS rtdata_main RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
