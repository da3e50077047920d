"""Links the archive for the board's core: PlatformIO runs this when it builds the library."""
import os

Import("env")  # noqa: F821: PlatformIO's

CPU = env.BoardConfig().get("build.cpu", "") if env.get("BOARD") else "native"  # noqa: F821
FOLDER = os.path.join(os.getcwd(), "src", CPU)
if not os.path.exists(os.path.join(FOLDER, "libeecvs.a")):
    raise SystemExit(f"eecvs: the library has no archive for the core {CPU!r}")
# The program is linked with these, not the library.
for environment in (env, DefaultEnvironment()):  # noqa: F821
    environment.Append(LIBPATH=[FOLDER], LIBS=["eecvs", *(["pthread", "dl", "m"] if CPU == "native" else [])])
