from .loopback import ADDRESS as ADDRESS, REFUSAL as REFUSAL, may_ask as may_ask
from .pages import Page as Page, PageServer as PageServer
from .space import SpaceServer as SpaceServer
from .watching import (
    Watched as Watched,
    picture_page as picture_page,
    thumbnail as thumbnail,
    watch_page as watch_page,
)
