from typing import Any

Stream = tuple[bytes, bytes, bool]
Row = tuple[Any, ...]
Found = tuple[Row, list[list[float]], list[float]]

version: str

def estimate(a: Stream, b: Stream, settings: dict[str, Any]) -> tuple[Found | None, str, Row]: ...
def course(a: Stream, b: Stream, settings: dict[str, Any]) -> tuple[Course | None, str]: ...

class Course:
    def at(self, times: bytes) -> bytes: ...
    def b_to_a(self, times: bytes) -> bytes: ...
    def details(
        self,
    ) -> tuple[
        list[Row],
        tuple[int, int, int],
        list[tuple[Row, int]],
        list[tuple[float, float, float, float]],
        list[tuple[float, float]],
        list[tuple[str, int]],
        tuple[float, float],
    ]: ...
