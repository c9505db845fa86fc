// The page of `srf study`: self-contained HTML.
#pragma once

#include <functional>
#include <string>

#include "apps/study_file.h"

namespace srf {

/// The picture of a setting at the study's middle frame; an empty one where it is not kept.
using PictureOf = std::function<ImageF(const MeasuredSetting&)>;
std::string studyPage(const Study& study, const PictureOf& picture);

}  // namespace srf
