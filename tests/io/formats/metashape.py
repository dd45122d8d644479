"""A cameras.xml as Metashape exports it, made by hand."""

LENS = """<resolution width="1200" height="800"/>
<f>1000</f> <cx>12.5</cx> <cy>-7.25</cy> <b1>3</b1> <b2>-2</b2>
<k1>-0.1</k1> <k2>0.02</k2> <k3>0.005</k3> <p1>0.004</p1> <p2>-0.003</p2>"""
# A quarter turn about z, in the chunk and in the world.
TURNED = "0 -1 0 2  1 0 0 -1  0 0 1 0.5  0 0 0 1"
CHUNK = """<transform><rotation locked="true">0 -1 0 1 0 0 0 0 1</rotation>
<translation locked="true">10 20 30</translation><scale locked="true">4</scale></transform>"""


def cameras_xml(
    lens=LENS, kind="frame", motion=TURNED, chunk=CHUNK, sensor="", camera="", head=""
) -> str:
    """The text of a file of one camera, "left.jpg", with more in it where that is given."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
{head}
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="1"><sensor id="0" label="EOS" type="{kind}">
<resolution width="1200" height="800"/><property name="focal_length" value="10.26"/>
<bands><band label="Red"/></bands><data_type>uint8</data_type>{sensor}
<calibration type="{kind}" class="initial"><resolution width="9" height="9"/><f>1</f></calibration>
<calibration type="{kind}" class="adjusted">{lens}</calibration>
<covariance><params>f cx</params><coeffs>1 0 0 1</coeffs></covariance></sensor></sensors>
<cameras next_id="2"><group id="0" label="G">
<camera id="0" sensor_id="0" label="left.jpg"><transform>{motion}</transform>
<orientation>1</orientation><reference x="1" y="2" z="3" enabled="true"/>{camera}</camera></group>
<camera id="1" sensor_id="0" label="not aligned.jpg"/></cameras>{chunk}
<reference>LOCAL_CS["Local Coordinates (m)"]</reference></chunk></document>"""
