"""Exercises that check themselves: questions on the lecture, notebooks for students, checks for teachers."""

from pinmobile.exercises._exercise import load_exercise
from pinmobile.exercises._tool import check_exercises, list_exercises, start_exercises

__all__ = ["check_exercises", "list_exercises", "load_exercise", "start_exercises"]
