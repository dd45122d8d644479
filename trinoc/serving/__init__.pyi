from .loopback import ADDRESS as ADDRESS, REFUSAL as REFUSAL, may_ask as may_ask
from .pages import Page as Page, serve_pages as serve_pages
from .space import serve_space as serve_space
from .watching import (
    Watched as Watched,
    picture_page as picture_page,
    thumbnail as thumbnail,
    watch_page as watch_page,
)
