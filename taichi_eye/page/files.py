"""The files of the pages, as the package ships them."""

from pathlib import Path

from starlette.responses import FileResponse

STATIC = Path(__file__).parent / "static"


def page(name: str):
    """What answers with one of them."""

    async def answer(request):
        return FileResponse(STATIC / name)

    return answer
