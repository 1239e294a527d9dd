#pragma once
#include <cstdio>
#define RCLCPP_ERROR(logger, ...) ((void)(logger), (void)std::printf(__VA_ARGS__))
