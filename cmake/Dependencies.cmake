# Every third-party library, with the version of Debian 12 and the reason. One adapter file includes each.
find_package(TBB 2021 REQUIRED)                 # threads; Embree's scheduler too
find_package(embree 3.13 REQUIRED)              # ray casting (base/ray_scene.cpp)
find_package(OpenEXR 3.1 REQUIRED)              # frames and layers (base/image_io.cpp)
find_package(OpenImageIO 2.4 REQUIRED)          # photographs (base/image_io.cpp); its config needs openimageio-tools
find_package(nlohmann_json 3.11 REQUIRED)       # JSON (base/json.cpp)
find_package(CLI11 2.1 REQUIRED)                # command lines (apps/)
# Silhouettes, distance maps; camera response; boards and lenses (aruco: libopencv-contrib-dev) (acquire/).
find_package(OpenCV 4.6 REQUIRED COMPONENTS core imgproc photo calib3d aruco)
find_package(Eigen3 3.4 CONFIG REQUIRED)        # before CGAL, whose own FindEigen3 hides the config
find_package(CGAL 5.5 REQUIRED)                 # point clouds, mesh repair (acquire/shape_import.cpp); GPL-3.0-or-later
find_package(pugixml 1.13 REQUIRED)             # XML of Metashape (acquire/import_capture.cpp, export_capture.cpp)
find_package(hwy 1.0.3 CONFIG REQUIRED)         # vector code, chosen at run time (render/*_kernels.cpp)
find_package(PkgConfig REQUIRED)
pkg_check_modules(matio REQUIRED IMPORTED_TARGET matio)     # MATLAB files of DiLiGenT-MV (acquire/import_capture.cpp)
pkg_check_modules(zstd REQUIRED IMPORTED_TARGET libzstd)    # blocks (field/reflectance_store.cpp)
pkg_check_modules(xxhash REQUIRED IMPORTED_TARGET libxxhash)  # checksums (base/files.cpp)
if(SRF_BENCH)
  find_package(benchmark 1.7 REQUIRED)          # kernels, timed (bench/kernel_benchmark.cpp)
endif()
if(SRF_TESTS)
  find_package(GTest 1.12 REQUIRED)
  include(GoogleTest)
endif()
