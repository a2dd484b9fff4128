"""A Django site in one file, whose photographs have previews: python django_photos.py DATA [PHOTO ...]

Needs pip install 'django>=5.2'. With photographs, it adds them to the site in the folder DATA; without, it serves the
site at http://127.0.0.1:8080. In a real project, Photo goes into models.py, and PAGE into a template.
"""

import sys
from importlib.resources import files
from pathlib import Path

import django
from django.conf import settings
from django.core.files import File
from django.core.management import call_command
from django.core.wsgi import get_wsgi_application
from django.db import connection, models
from django.http import HttpResponse
from django.template import Context, Engine
from django.urls import path
from django.views.static import serve

import sgmethod

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Photographs</title>
<style>
sg-img { display: grid; grid: minmax(0, 1fr) / minmax(0, 1fr); height: min-content; max-width: 40em; }
sg-img img { display: block; min-width: 100%; max-width: 100%; height: 100%; object-fit: cover; }
</style>
<script type="module" src="/sgmethod/sg-img.js"></script>
{% for photo in photos %}
<sg-img preview="{{ photo.preview }}">
  <img src="{{ photo.image.url }}" alt="{{ photo.alt }}" width="{{ photo.width }}" height="{{ photo.height }}"
       loading="lazy" decoding="async">
</sg-img>
{% endfor %}
</html>
"""
MODULES = str(files("sgmethod") / "javascript" / "src")

if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
    sys.exit("usage: python django_photos.py DATA [PHOTO ...]")
data = Path(sys.argv[1]).resolve()
settings.configure(
    ALLOWED_HOSTS=["127.0.0.1", "localhost"],
    DATABASES={"default": {"ENGINE": "django.db.backends.sqlite3", "NAME": data / "photos.sqlite3"}},
    DEFAULT_AUTO_FIELD="django.db.models.BigAutoField",
    MEDIA_ROOT=data / "media",
    MEDIA_URL="/media/",
    ROOT_URLCONF=__name__,
)
django.setup()


class Photo(models.Model):
    """A photograph, and its preview as text for the page."""

    image = models.ImageField(upload_to="photos")
    width = models.PositiveIntegerField(editable=False)  # as displayed; width_field would ignore EXIF orientation
    height = models.PositiveIntegerField(editable=False)
    alt = models.CharField(max_length=200)
    preview = models.CharField(max_length=300, editable=False)  # 4 characters for 3 bytes

    class Meta:
        app_label = "photos"

    def save(self, *args, **options) -> None:
        """Make the preview, and save both."""
        made = sgmethod.preview(self.image.read(), bytes=200)
        self.preview, self.width, self.height = made.text, made.width, made.height
        self.image.seek(0)
        super().save(*args, **options)


def index(request) -> HttpResponse:
    """The page of all photographs."""
    return HttpResponse(Engine().from_string(PAGE).render(Context({"photos": Photo.objects.all()})))


urlpatterns = [
    path("", index),
    path("media/<path:path>", serve, {"document_root": settings.MEDIA_ROOT}),
    path("sgmethod/<path:path>", serve, {"document_root": MODULES}),
]
application = get_wsgi_application()


def main() -> None:
    """Add the photographs of the command line, or serve the site."""
    data.mkdir(parents=True, exist_ok=True)
    if Photo._meta.db_table not in connection.introspection.table_names():
        with connection.schema_editor() as editor:  # a project has migrations
            editor.create_model(Photo)
    for name in sys.argv[2:]:
        with Path(name).open("rb") as file:
            photo = Photo.objects.create(image=File(file, Path(name).name), alt=Path(name).stem)
        print(f"{name}: {photo.width} x {photo.height}, preview {photo.preview[:20]}...")
    if not sys.argv[2:]:
        call_command("runserver", "127.0.0.1:8080", "--noreload")


if __name__ == "__main__":
    main()
