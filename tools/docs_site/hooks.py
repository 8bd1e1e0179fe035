"""MkDocs calls these functions: pages made from the code are added to those that are written by hand."""

from __future__ import annotations

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

from tools.docs_site.api import api_page
from tools.docs_site.commands import commands_page
from tools.docs_site.settings import settings_page

PAGES = {
    "reference/api.md": api_page,
    "reference/commands.md": commands_page,
    "reference/settings.md": settings_page,
}


# the theme would load this from another host, for search in pages that are opened as files
_FOREIGN_SCRIPT = "https://unpkg.com/iframe-worker/shim"
_OWN_SCRIPT = "javascripts/search_from_files.js"


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Replace the theme's only script of another host by ours."""
    return output.replace(_FOREIGN_SCRIPT, get_relative_url(_OWN_SCRIPT, page.url))


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:
    """The same in the page of a web server for addresses that do not exist."""
    return output.replace(_FOREIGN_SCRIPT, f"/{_OWN_SCRIPT}")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for path, page in PAGES.items():
        files.append(File.generated(config, path, content=page()))
    return files
