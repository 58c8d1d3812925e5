# The installed package: headers, libraries, CMake package, pkg-config files, the program.
set(RTDATA_CMAKE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/rtdata)
install(DIRECTORY include/rtdata DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
set(RTDATA_TARGETS rtdata)
foreach(optional rtdata_sqlite rtdata_program)
  if(TARGET ${optional})
    list(APPEND RTDATA_TARGETS ${optional})
  endif()
endforeach()
install(TARGETS ${RTDATA_TARGETS} EXPORT rtdata-targets
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(EXPORT rtdata-targets NAMESPACE rtdata:: DESTINATION ${RTDATA_CMAKE_DIR})

set(RTDATA_WITH_PROGRAM OFF)
if(TARGET rtdata_program)
  set(RTDATA_WITH_PROGRAM ON)
endif()
configure_package_config_file(cmake/rtdata-config.cmake.in rtdata-config.cmake INSTALL_DESTINATION ${RTDATA_CMAKE_DIR})
write_basic_package_version_file(rtdata-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rtdata-config.cmake ${CMAKE_CURRENT_BINARY_DIR}/rtdata-config-version.cmake
  DESTINATION ${RTDATA_CMAKE_DIR})

# Relative to the .pc file, so that the package can be installed with another prefix, or moved.
if(IS_ABSOLUTE "${CMAKE_INSTALL_LIBDIR}")
  set(RTDATA_PC_PREFIX ${CMAKE_INSTALL_PREFIX})
else()
  file(RELATIVE_PATH RTDATA_PC_PREFIX /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
  string(REGEX REPLACE "/$" "" RTDATA_PC_PREFIX "\${pcfiledir}/${RTDATA_PC_PREFIX}")
endif()
# Who links a static library links what that needs, also without --static, which asks for what only static libraries of
# others need.
if(NOT BUILD_SHARED_LIBS)
  set(RTDATA_PC_LIBUV "libuv >= 1.43")
  set(RTDATA_PC_SQLITE "sqlite3 >= 3.37")
endif()
foreach(module rtdata rtdata-sqlite)
  configure_file(cmake/${module}.pc.in ${module}.pc @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/${module}.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()

# The service starts the program where it is installed, which only the installation knows (--prefix).
if(TARGET rtdata_main)
  install(CODE "
    set(RTDATA_BINDIR \"${CMAKE_INSTALL_BINDIR}\")
    cmake_path(ABSOLUTE_PATH RTDATA_BINDIR BASE_DIRECTORY \"\${CMAKE_INSTALL_PREFIX}\" NORMALIZE)
    configure_file([[${CMAKE_CURRENT_SOURCE_DIR}/packaging/rtdata@.service.in]] [[${CMAKE_CURRENT_BINARY_DIR}/rtdata@.service]] @ONLY)")
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rtdata@.service DESTINATION lib/systemd/system)
endif()
