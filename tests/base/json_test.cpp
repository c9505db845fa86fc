#include "base/json.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "base/files.h"
#include "tests/support/test_support.h"

namespace srf {
namespace {

/// What the error says; "" where nothing is thrown.
template <class Action>
std::string complaint(const Action& action, ErrorKind kind = ErrorKind::bad_input) {
  try {
    action();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), kind) << e.what();
    return e.what();
  }
  return "";
}

JsonNode scene() {
  return parseJson(R"({"camera": {"w": 512, "name": "a"}, "lights": [{"type": "point", "position": [1, 2, 3]}]})",
                   "scene.json");
}

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

TEST(Json, ErrorsNameFilePointerAndWhatWasFound) {
  const std::string text = complaint([] { scene()["lights"].at(0)["position"].at(1).string(); });
  EXPECT_TRUE(holds(text, "scene.json: /lights/0/position/1")) << text;
  EXPECT_TRUE(holds(text, "found 2")) << text;
  EXPECT_TRUE(holds(text, "expected a string")) << text;
}

TEST(Json, AnUnknownKeyNamesTheNearestKnownOne) {
  const std::string text = complaint([] { scene()["lights"].at(0).onlyKeys({"type", "postion", "intensity"}); });
  EXPECT_TRUE(holds(text, "/lights/0/position")) << text;
  EXPECT_TRUE(holds(text, "did you mean 'postion'?")) << text;
  const std::string far = complaint([] { scene()["camera"].onlyKeys({"name", "zebra"}); });
  EXPECT_TRUE(holds(far, "'w'")) << far;
  EXPECT_TRUE(holds(far, "known here: name, zebra")) << far;
}

TEST(Json, PointersOfKeysWithSlashesAreEscaped) {
  const auto node = parseJson(R"({"a/b": {"c~d": 1}})", "x.json");
  EXPECT_EQ(node["a/b"]["c~d"].pointer(), "/a~1b/c~0d");
  EXPECT_TRUE(holds(complaint([&] { node.onlyKeys({"c"}); }), "/a~1b"));
}

TEST(Json, AKeyThatStandsTwiceIsAnErrorThatNamesItsPlace) {
  const auto refusal = [](const char* text) { return complaint([&] { parseJson(text, "scene.json"); }); };
  const std::string top = refusal(R"({"fps": 24, "lights": [], "fps": 25})");
  EXPECT_TRUE(holds(top, "scene.json: /fps: the key 'fps' stands twice; keep one of the two")) << top;
  const std::string deep = refusal(R"({"a": [1, [2, {"x": 1}], {"b/c": {"d": {}, "e": [], "d": 2}}]})");
  EXPECT_TRUE(holds(deep, "scene.json: /a/2/b~1c/d: ")) << deep;
  const std::string big = refusal(R"({"a": {"k": {}}, "b": {"k": [{"a": 1}, {"a": 1}], "a": 3}, "c": 0, "b": 0})");
  EXPECT_TRUE(holds(big, "scene.json: /b: ")) << big;
}

TEST(Json, OneKeyInSeveralObjectsIsNoKeyTwice) {
  const auto node = parseJson(R"({"a": {"a": 1, "b": {"a": 2}}, "list": [{"a": 3}, {"a": 4}], "b": 5})", "scene.json");
  EXPECT_EQ(node["list"].at(1)["a"].number(), 4);
}

TEST(Json, AnOverrideWithAKeyTwiceIsAnErrorToo) {
  const auto node = parseJson(R"({"a": 1})", "scene.json");
  const std::string text = complaint([&] { withOverride(node, R"(/a={"x": 1, "x": 2})"); });
  EXPECT_TRUE(holds(text, "--set /a: /x: the key 'x' stands twice")) << text;
  EXPECT_EQ(withOverride(node, "/a={\"x")["a"].string(), "{\"x");
}

TEST(Json, MissingKeysSaySo) {
  const std::string text = complaint([] { scene()["camera"]["vfov"]; });
  EXPECT_TRUE(holds(text, "/camera") && holds(text, "'vfov' is missing")) << text;
  EXPECT_FALSE(scene()["camera"].find("vfov"));
  EXPECT_TRUE(scene()["camera"].has("w"));
}

TEST(Json, SyntaxErrorsGiveLineAndColumn) {
  const std::string text = complaint([] { parseJson("{\n  \"a\": 1,\n  \"b\" 2\n}", "scene.json"); });
  EXPECT_TRUE(holds(text, "scene.json") && holds(text, "line 3, column 7")) << text;
  EXPECT_TRUE(holds(complaint([] { parseJson("", "empty.json"); }), "line 1, column 1"));
  EXPECT_TRUE(holds(complaint([] { parseJson("{\"a\": 1", "short.json"); }), "line 1"));
  EXPECT_TRUE(holds(complaint([] { parseJson("{\"a\": \"\xff\"}", "bytes.json"); }), "bytes.json"));
}

TEST(Json, NumbersBeyondDoubleAreBadInput) {
  const std::string text = complaint([] { parseJson("{\n\"a\": 1e999}", "scene.json"); });
  EXPECT_TRUE(holds(text, "scene.json") && holds(text, "1e999")) << text;
}

TEST(Json, AbsurdNestingIsRefusedAndDoesNotEndTheProgram) {
  const std::string deep = std::string(2000000, '[');
  EXPECT_TRUE(holds(complaint([&] { parseJson(deep, "deep.json"); }), "deep.json"));
  const std::string closed = std::string(500000, '[') + std::string(500000, ']');
  EXPECT_TRUE(holds(complaint([&] { parseJson(closed, "deep.json"); }), "nested"));
  const std::string fine = std::string(50, '[') + std::string(50, ']');
  EXPECT_EQ(parseJson(fine, "fine.json").size(), 1u);
}

TEST(Json, WrongTypesAreToldForEveryReader) {
  const auto node = parseJson(R"({"a": [1, "x", true, null, {}, 1.5, -1, [1, 2]]})", "x.json")["a"];
  EXPECT_TRUE(holds(complaint([&] { node.at(1).number(); }), "expected a number"));
  EXPECT_TRUE(holds(complaint([&] { node.at(6).positiveNumber(); }), "above 0"));
  EXPECT_TRUE(holds(complaint([&] { node.at(5).integer(0, 9); }), "whole number from 0 to 9"));
  EXPECT_TRUE(holds(complaint([&] { node.at(6).integer(0, 9); }), "whole number"));
  EXPECT_TRUE(holds(complaint([&] { node.at(0).boolean(); }), "true or false"));
  EXPECT_TRUE(holds(complaint([&] { node.at(7).vec3(); }), "3 numbers"));
  EXPECT_TRUE(holds(complaint([&] { node.at(3).onlyKeys({}); }), "an object"));
  EXPECT_TRUE(holds(complaint([&] { node.at(4).size(); }), "an array"));
  EXPECT_TRUE(holds(complaint([&] { node.at(8); }), "8 entries"));
  EXPECT_TRUE(holds(complaint([&] { node.at(1).choice({"y", "z"}); }), "one of 'y', 'z'"));
  EXPECT_TRUE(holds(complaint([&] { node["key"]; }), "an object"));
  EXPECT_EQ(node.at(1).choice({"w", "x"}), 1u);
  EXPECT_TRUE(node.at(2).boolean());
}

TEST(Json, OverridesSetChangeAndAdd) {
  const auto changed = withOverride(scene(), "/camera/w=64");
  EXPECT_EQ(changed["camera"]["w"].integer(1, 1000), 64);
  EXPECT_EQ(changed["camera"]["name"].string(), "a");
  EXPECT_EQ(withOverride(scene(), "/accuracy/views=8")["accuracy"]["views"].number(), 8);
  EXPECT_EQ(withOverride(scene(), "/camera/name=two words")["camera"]["name"].string(), "two words");
  EXPECT_EQ(withOverride(scene(), "/camera/name=a=b")["camera"]["name"].string(), "a=b");
  EXPECT_EQ(withOverride(scene(), "/lights/0/position=[4, 5, 6]")["lights"].at(0)["position"].vec3(), (Vec3{4, 5, 6}));
  EXPECT_EQ(withOverride(scene(), "/lights/1={\"type\": \"directional\"}")["lights"].size(), 2u);
  EXPECT_EQ(scene()["camera"]["w"].number(), 512);
}

TEST(Json, OverridesThatDoNotFitAreUsageErrors) {
  for (const char* text : {"camera/w=1", "/camera/w", "", "/lights/x=1", "/camera/w/deeper=1", "/a~2=1", "/lights/2=1",
                           "/lights/4000000000=1", "/lights/4000000000/x=1"})
    EXPECT_NE(complaint([&] { withOverride(scene(), text); }, ErrorKind::usage), "") << text;
}

TEST(Json, FilesRoundTripWithAllDigits) {
  const test::TemporaryFolder folder;
  Json value;
  value["x"] = 0.1 + 0.2;
  value["tiny"] = 4.9e-324;
  value["z first"] = true;
  writeJsonFile(folder / "a.json", value);
  const auto node = readJsonFile(folder / "a.json");
  EXPECT_EQ(node["x"].number(), 0.1 + 0.2);
  EXPECT_EQ(node["tiny"].number(), 4.9e-324);
  EXPECT_TRUE(holds(complaint([&] { readJsonFile(folder / "none.json"); }), "none.json"));
}

TEST(NearestWord, IsWithinAFewLettersOrNone) {
  EXPECT_EQ(nearestWord("dirction", {"direction", "position"}), "direction");
  EXPECT_EQ(nearestWord("colour", {"direction", "position"}), "");
  EXPECT_EQ(nearestWord("", {"direction"}), "");
}

}  // namespace
}  // namespace srf
