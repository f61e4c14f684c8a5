"""What is taken for a browser: a program that starts, not one that only bears the name."""

from taichi_eye.bench import browser


def test_a_stub_that_bears_a_browser_s_name_is_passed_over(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert browser.program.__wrapped__() is None
    for name, status in (("chromium-browser", 1), ("google-chrome", 0)):
        (tmp_path / name).write_text(f"#!/bin/sh\nexit {status}\n")
        (tmp_path / name).chmod(0o755)
    assert browser.program.__wrapped__() == str(tmp_path / "google-chrome")
