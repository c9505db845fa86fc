# Warnings, language and instruction set, carried by the interface target srf_flags; no global flag strings.
option(SRF_TESTS "build the tests" ON)
option(SRF_BENCH "build the benchmarks" ON)
set(SRF_MARCH "x86-64-v3" CACHE STRING "instruction set; x86-64-v3 is AVX2, FMA and F16C")
set(SRF_SANITIZE "" CACHE STRING "e.g. address,undefined or thread")
set(SRF_TEST_TIMEOUT 900 CACHE STRING "seconds after which a test has failed; tools/nightly.sh gives more")

if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
find_program(SRF_CCACHE ccache)
if(SRF_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${SRF_CCACHE})
endif()
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)

add_library(srf_flags INTERFACE)
target_compile_features(srf_flags INTERFACE cxx_std_20)
# Contraction is off so that a sum has the same bits wherever the compiler inlines it; std::fma is written where meant.
target_compile_options(srf_flags INTERFACE -Wall -Wextra -Wno-missing-field-initializers -Wno-restrict -ffp-contract=off -march=${SRF_MARCH})
target_compile_definitions(srf_flags INTERFACE SRF_VERSION="${PROJECT_VERSION}")
target_include_directories(srf_flags INTERFACE ${PROJECT_SOURCE_DIR})
if(SRF_SANITIZE)
  target_compile_options(srf_flags INTERFACE -fsanitize=${SRF_SANITIZE} -fno-omit-frame-pointer)
  target_link_options(srf_flags INTERFACE -fsanitize=${SRF_SANITIZE})
endif()

# srf_library(name SOURCES a.cpp .. PUBLIC targets .. PRIVATE targets ..): the static library srf_<name>, alias srf::<name>.
function(srf_library name)
  cmake_parse_arguments(A "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(srf_${name} STATIC ${A_SOURCES})
  add_library(srf::${name} ALIAS srf_${name})
  target_link_libraries(srf_${name} PUBLIC srf_flags ${A_PUBLIC} PRIVATE ${A_PRIVATE})
endfunction()

# srf_program(command targets ..): the program srf-<command> from <command>.cpp.
function(srf_program command)
  add_executable(srf-${command} ${command}.cpp)
  target_link_libraries(srf-${command} PRIVATE srf::program ${ARGN})
  install(TARGETS srf-${command})
endfunction()

# srf_test(folder SOURCES .. LINK ..): the test program test_<folder>; its tests are named <folder>/Suite.Test.
function(srf_test folder)
  cmake_parse_arguments(A "" "" "SOURCES;LINK" ${ARGN})
  add_executable(test_${folder} ${A_SOURCES})
  # Expectations are wide and never hot: optimised less, they take two thirds of the time to compile.
  target_compile_options(test_${folder} PRIVATE $<$<CONFIG:Release>:-O1>)
  target_link_libraries(test_${folder} PRIVATE srf::test_support ${A_LINK} GTest::gtest_main)
  gtest_discover_tests(test_${folder} TEST_PREFIX ${folder}/ DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 60
                       PROPERTIES TIMEOUT ${SRF_TEST_TIMEOUT})
endfunction()
