"""Write a page of photographs with previews: python static_page.py PHOTOS SITE

Any static host can serve SITE, and so can python -m http.server. Each photograph is a WebP that loads lazily. Until it
has loaded, the page shows a preview of at most 200 bytes, which is part of its HTML.
"""

import html
import shutil
import sys
from importlib.resources import as_file, files
from pathlib import Path
from urllib.parse import quote

from PIL import Image, ImageOps

import sgmethod

SUFFIXES = (".jpg", ".jpeg", ".png")
PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>Photographs</title>
<link rel="stylesheet" href="style.css">
<script type="module" src="sgmethod/sg-img.js"></script>
{pictures}
</html>
"""
STYLE = """
body { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 30em), 1fr)); gap: 1em; margin: 1em; }
sg-img { display: grid; grid: minmax(0, 1fr) / minmax(0, 1fr); height: min-content; }
sg-img img { display: block; min-width: 100%; max-width: 100%; height: 100%; object-fit: cover; }
"""


def write_site(photos: Path, site: Path) -> None:
    """Write a page of every photograph in a folder."""
    (site / "photos").mkdir(parents=True, exist_ok=True)
    pictures = []
    for path in sorted(path for path in photos.iterdir() if path.suffix.lower() in SUFFIXES):
        with Image.open(path) as photo:
            upright = ImageOps.exif_transpose(photo)
        upright.thumbnail((1600, 1600))
        target = site / "photos" / f"{path.name}.webp"  # a.jpg may lie beside a.png
        upright.save(target)
        preview = sgmethod.preview(upright, bytes=200)
        pictures.append(preview_element(preview, f"photos/{quote(target.name)}", path.stem))
    (site / "index.html").write_text(PAGE.format(pictures="\n".join(pictures)), encoding="utf-8")
    (site / "style.css").write_text(STYLE, encoding="utf-8")
    with as_file(files("sgmethod") / "javascript" / "src") as modules:  # or sg-img.js of the npm package
        shutil.copytree(modules, site / "sgmethod", dirs_exist_ok=True)
    print(f"{site / 'index.html'}, photographs: {len(pictures)}")


def preview_element(preview: sgmethod.Preview, url: str, alt: str) -> str:
    """Return the HTML of one photograph. It reserves the photograph's space before anything has loaded."""
    size = f'width="{preview.width}" height="{preview.height}"'
    img = f'<img src="{html.escape(url)}" alt="{html.escape(alt)}" {size} loading="lazy" decoding="async">'
    return f'<sg-img preview="{preview.text}">{img}</sg-img>'


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python static_page.py PHOTOS SITE")
    write_site(Path(sys.argv[1]), Path(sys.argv[2]))
