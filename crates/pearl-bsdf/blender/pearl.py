"""A pearl as a material of Blender's own nodes, written by `lut export --to blender` (Blender 4.2 and newer).

Run it in Blender's text editor or by `blender -P FILE`: it makes the material "Pearl" and puts it on what is selected.
As an add-on it adds File > Import > Pearl, which reads such files.
"""

import array
import base64
import json
import math
import pathlib
import zlib

import bpy
from bpy_extras.io_utils import ImportHelper

SCHEMA = "pearl-blender/1"
#: The pearl as JSON; its pixels are zlib and base64 of 32-bit floats, little-endian, first row first.
PEARL = r"""{}"""


def pearl_of(text):
    """The pearl in the text of such a file, which is read, not run."""
    start, end = 'PEARL = r"""', '"""\n'
    _, found, rest = text.partition("\n" + start)
    try:
        pearl = json.loads(rest.partition(end)[0])
    except ValueError:
        pearl = None
    if not found or not isinstance(pearl, dict) or pearl.get("schema") != SCHEMA:
        raise ValueError(f"not a pearl: expected a file of schema {SCHEMA}, written by `lut export --to blender`")
    return pearl


def image_of(pearl):
    """The curves over the viewing angle as a packed picture; a row a curve."""
    width, height = pearl["width"], pearl["height"]
    values = array.array("f", zlib.decompress(base64.b64decode(pearl["pixels"])))
    pixels = array.array("f", [1.0]) * (4 * width * height)
    for channel in range(3):
        pixels[channel::4] = values[channel::3]
    image = bpy.data.images.new(f"Pearl {pearl['name']}", width, height, float_buffer=True, is_data=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels)
    image.pack()
    return image


class Graph:
    """Nodes of a tree, each to the right of what it reads."""

    def __init__(self, tree):
        self.tree, self.depth, self.columns = tree, {}, {}

    def node(self, kind, inputs=None, **settings):
        """A node with these settings; inputs by place or name are sockets to link or values to set."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        depth = 0
        for key, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
                depth = max(depth, self.depth[value.node.name] + 1)
            else:
                node.inputs[key].default_value = value
        self.depth[node.name] = depth
        row = self.columns[depth] = self.columns.get(depth, -1) + 1
        node.location, node.hide = (200 * depth, -45 * row), kind != "NodeGroupInput"
        return node

    def math(self, operation, *inputs, **settings):
        return self.node("ShaderNodeMath", dict(enumerate(inputs)), operation=operation, **settings).outputs[0]

    def vector(self, operation, *inputs):
        """A vector, or a number where the operation gives one."""
        node = self.node("ShaderNodeVectorMath", dict(enumerate(inputs)), operation=operation)
        return node.outputs["Value" if operation in {"DOT_PRODUCT", "LENGTH"} else "Vector"]

    def scaled(self, vector, by):
        return self.node("ShaderNodeVectorMath", {"Vector": vector, "Scale": by}, operation="SCALE").outputs["Vector"]


class Curves:
    """Reads the picture."""

    def __init__(self, graph, pearl, thickness):
        self.graph, self.image, self.rows = graph, image_of(pearl), pearl["rows"]
        self.width, self.height = pearl["width"], pearl["height"]
        scales = pearl["scales"]
        self.count, self.place = len(scales), None
        if self.count > 1:
            # Ratios of neighbouring scales are equal below 1 and above it.
            one, first, last = scales.index(1.0), math.log(scales[0]), math.log(scales[-1])
            log = graph.math("LOGARITHM", thickness, math.e)
            parts = [graph.math("ADD", float(one), 0.0)]
            if one > 0:
                low = graph.math("MINIMUM", graph.math("MAXIMUM", log, first), 0.0)
                parts.append(graph.math("MULTIPLY", low, one / -first))
            if one < self.count - 1:
                high = graph.math("MAXIMUM", graph.math("MINIMUM", log, last), 0.0)
                parts.append(graph.math("MULTIPLY", high, (self.count - 1 - one) / last))
            place = parts[0]
            for part in parts[1:]:
                place = graph.math("ADD", place, part)
            self.place = graph.math("DIVIDE", place, float(self.height))

    def at(self, angle):
        """Where an angle is across the picture: a socket or a number, radians."""
        share = 2 / math.pi * (self.width - 1) / self.width
        if isinstance(angle, float):
            return angle * share + 0.5 / self.width
        return self.graph.math("MULTIPLY_ADD", angle, share, 0.5 / self.width)

    def read(self, name, u, nth=0, scaled=False):
        """A curve's colour; of a curve that depends on the thickness there is a row a scale."""
        row = self.rows[name] + nth * (self.count if scaled else 1)
        v = (row + 0.5) / self.height
        if scaled and self.place is not None:
            v = self.graph.math("ADD", self.place, v)
        at = self.graph.node("ShaderNodeCombineXYZ", {0: u, 1: v}).outputs[0]
        node = self.graph.node("ShaderNodeTexImage", {"Vector": at}, image=self.image, extension="EXTEND")
        return node.outputs["Color"]


def socket(tree, name, kind, value=None, low=0.0, high=1.0, tip=""):
    made = tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    made.description = tip
    if kind == "Float":
        made.min_value, made.max_value = low, high
        made.subtype = "FACTOR" if high == 1.0 else "NONE"
    if value is not None:
        made.default_value = value
    if kind == "Vector":
        made.hide_value = True


def interface(tree, pearl):
    """The controls, with the look of the recipe."""
    look, scales = pearl["look"], pearl["scales"]
    tree.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    if pearl["emission"]:
        socket(tree, "Depth", "Float", look["depth"], tip="Share of incoherent interference in the base")
    socket(tree, "Brightness", "Float", look["brightness"], tip="Strength of the lobes; what they leave feeds the base")
    if pearl["coherent"]:
        socket(tree, "Coherence", "Float", look["coherence"], tip="How much of the interference colours the lobes show")
    socket(tree, "Body Color", "Color", (*look["body_rgb"], 1.0), tip="Body colour")
    if pearl["emission"] or pearl["coherent"]:
        socket(tree, "Interference Tint", "Color", (*look["tint_rgb"], 1.0), tip="Factor of the interference colours")
    if len(scales) > 1:
        socket(tree, "Thickness", "Float", look["thickness"], scales[0], scales[-1], "Scale of all layers' thicknesses")
    socket(tree, "Grain", "Float", 0.0, tip="Strength of a noise in the normal")
    socket(tree, "Grain Scale", "Float", 40.0, 0.0, 10000.0, "Bumps over a unit of the object")
    socket(tree, "Normal", "Vector", tip="Normal, such as of a normal map; the surface's own where nothing is linked")


def grained(graph, given):
    """The normal."""
    linked = graph.math("LESS_THAN", graph.vector("LENGTH", given["Normal"]), 0.5)
    surface = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    normal = graph.vector("ADD", given["Normal"], graph.scaled(surface, linked))
    place = graph.node("ShaderNodeTexCoord").outputs["Object"]
    noise = graph.node("ShaderNodeTexNoise", {"Vector": place, "Scale": given["Grain Scale"], "Detail": 1.0})
    # Slopes that do not depend on the scale.
    distance = graph.math("DIVIDE", 0.2, graph.math("MAXIMUM", given["Grain Scale"], 1e-3))
    height = noise.outputs[0]
    bump = {"Strength": given["Grain"], "Distance": distance, "Height": height, "Normal": normal}
    return graph.node("ShaderNodeBump", bump).outputs["Normal"]


def shares_of_base(graph, curves, edges, left):
    """The base over the direction of the light, (1 - albedo) cos: diffuse, and ramps about the normal; of a sum of 1."""
    cosines = [math.cos(edge) for edge in edges[:-1]] + [0.0]
    drops = [a - b for a, b in zip(cosines, cosines[1:])]
    light = [graph.scaled(left(curves.at(edge)), cos) for edge, cos in zip(edges, cosines[:-1])]
    light.append((0.0, 0.0, 0.0))
    slopes = [graph.scaled(graph.vector("SUBTRACT", a, b), 1 / drop) for a, b, drop in zip(light, light[1:], drops)]
    # As much diffuse light as leaves no ramp negative.
    diffuse = slopes[0]
    for slope in slopes[1:]:
        diffuse = graph.vector("MINIMUM", diffuse, slope)
    diffuse = graph.vector("MAXIMUM", diffuse, (0.0, 0.0, 0.0))
    shares = [graph.scaled(diffuse, math.pi)]
    for slope, drop, start, end in zip(slopes, drops, edges, edges[1:]):
        ramp = graph.vector("MAXIMUM", graph.vector("SUBTRACT", slope, diffuse), (0.0, 0.0, 0.0))
        shares.append(graph.scaled(ramp, drop * ramp_light(start, end)))
    total = shares[0]
    for share in shares[1:]:
        total = graph.vector("ADD", total, share)
    total = graph.vector("MAXIMUM", total, (1e-6, 1e-6, 1e-6))
    return [graph.vector("DIVIDE", share, total) for share in shares]


def ramp_light(start, end):
    """Integral of a ramp that falls from 1 to 0 between two angles to the normal."""
    return 2 * math.pi * (1 - (math.sin(end) - math.sin(start)) / (end - start))


def group_of(pearl):
    """The node group."""
    tree = bpy.data.node_groups.new(f"Pearl {pearl['name']}", "ShaderNodeTree")
    interface(tree, pearl)
    graph = Graph(tree)
    given = graph.node("NodeGroupInput").outputs
    curves = Curves(graph, pearl, given.get("Thickness"))
    normal = grained(graph, given)
    incoming = graph.node("ShaderNodeNewGeometry").outputs["Incoming"]
    cos = graph.math("MAXIMUM", graph.math("MINIMUM", graph.vector("DOT_PRODUCT", incoming, normal), 1.0), 0.0)
    view = curves.at(graph.math("ARCCOSINE", cos))
    along = graph.vector("NORMALIZE", graph.vector("SUBTRACT", incoming, graph.scaled(normal, cos)))

    tint, depth, coherence = (given.get(name) for name in ("Interference Tint", "Depth", "Coherence"))

    def shown(plain, modulated, u, nth=0):
        """brightness * mix(plain, tint * modulated, coherence)."""
        colour = curves.read(plain, u, nth)
        if coherence is not None:
            tinted = graph.vector("MULTIPLY", curves.read(modulated, u, nth, scaled=True), tint)
            apart = graph.vector("SUBTRACT", tinted, colour)
            colour = graph.vector("ADD", colour, graph.scaled(apart, coherence))
        return graph.scaled(colour, given["Brightness"])

    def left(u):
        """What the lobes leave to the base."""
        albedo = shown("plain_albedo", "modulated_albedo", u)
        return graph.vector("MAXIMUM", graph.vector("SUBTRACT", (1.0, 1.0, 1.0), albedo), (0.0, 0.0, 0.0))

    colour = (1.0, 1.0, 1.0)
    if depth is not None:
        emission = graph.vector("MULTIPLY", curves.read("emission", view, scaled=True), tint)
        apart = graph.vector("SUBTRACT", emission, colour)
        colour = graph.vector("ADD", graph.scaled(apart, depth), colour)
    colour = graph.vector("MULTIPLY", colour, given["Body Color"])
    base = graph.vector("MULTIPLY", graph.vector("MINIMUM", colour, (1.0, 1.0, 1.0)), left(view))
    edges = [math.radians(edge) for edge in pearl["edges_deg"]]
    shares = shares_of_base(graph, curves, edges, left)

    across = graph.vector("CROSS_PRODUCT", normal, along)
    turns = graph.node("ShaderNodeSeparateXYZ", {0: curves.read("turn", view)}).outputs
    shaders = []
    for lobe in range(pearl["lobes"]):
        shape = graph.node("ShaderNodeSeparateXYZ", {0: curves.read("shape", view, lobe)}).outputs
        # The normal of a lobe is tilted away from the viewer, in the plane of incidence.
        upright = graph.scaled(normal, graph.math("COSINE", shape[2]))
        tilted = graph.vector("SUBTRACT", upright, graph.scaled(along, graph.math("SINE", shape[2])))
        colour, normals = shown("plain", "modulated", view, lobe), [tilted]
        pair = lobe - (pearl["lobes"] - pearl["pairs"])
        if pair >= 0:
            # Two of half the light, turned to either side.
            colour = graph.scaled(colour, 0.5)
            level = graph.scaled(tilted, graph.math("COSINE", turns[pair]))
            aside = graph.scaled(across, graph.math("SINE", turns[pair]))
            normals = [graph.vector(operation, level, aside) for operation in ("ADD", "SUBTRACT")]
        for turned in normals:
            inputs = {
                "Color": colour,
                "Roughness": shape[0],
                "Anisotropy": shape[1],
                "Normal": graph.vector("NORMALIZE", turned),
                "Tangent": along,
            }
            shaders.append(graph.node("ShaderNodeBsdfAnisotropic", inputs, distribution="BECKMANN").outputs[0])
    for place, share in enumerate(shares):
        lobes = shown("plain", "modulated", view, pearl["lobes"] + place)
        start, end = edges[place - 1], edges[place]
        # A ramp of colour 1 has this much light.
        own = ramp_light(start, end) / (2 * math.pi * (1 - math.cos(end))) if place else 1.0
        colour = graph.vector("ADD", lobes, graph.scaled(graph.vector("MULTIPLY", base, share), 1 / own))
        inputs = {"Color": colour, "Normal": normal}
        if place == 0:
            shaders.append(graph.node("ShaderNodeBsdfDiffuse", inputs).outputs[0])
        else:
            inputs |= {"Size": 2 / math.pi * start, "Smooth": 2 / math.pi * (end - start)}
            shaders.append(graph.node("ShaderNodeBsdfToon", inputs, component="DIFFUSE").outputs[0])
    whole = shaders[0]
    for shader in shaders[1:]:
        whole = graph.node("ShaderNodeAddShader", {0: whole, 1: shader}).outputs[0]
    graph.node("NodeGroupOutput", {0: whole})
    return tree


def material_of(pearl):
    """The material."""
    material = bpy.data.materials.new("Pearl")
    if material.node_tree is None:
        material.use_nodes = True
    # Cycles would turn the tilted normals back.
    material.cycles.use_bump_map_correction = False
    nodes = material.node_tree.nodes
    nodes.clear()
    group, output = nodes.new("ShaderNodeGroup"), nodes.new("ShaderNodeOutputMaterial")
    group.node_tree, group.width, output.location = group_of(pearl), 240, (300, 0)
    material.node_tree.links.new(group.outputs[0], output.inputs["Surface"])
    return material


def put_on_selected(context, material):
    for selected in context.selected_objects:
        if hasattr(selected.data, "materials"):
            selected.active_material = material


class ImportPearl(bpy.types.Operator, ImportHelper):
    """Make the material of a pearl and put it on what is selected"""

    bl_idname = "import_scene.pearl"
    bl_label = "Import Pearl"
    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".py"
    filter_glob: bpy.props.StringProperty(default="*.py", options={"HIDDEN"})

    def invoke(self, context, event):
        # The pearl that the add-on came with is the first to be offered.
        self.filepath = self.filepath or str(pathlib.Path(__file__))
        return super().invoke(context, event)

    def execute(self, context):
        try:
            pearl = pearl_of(pathlib.Path(self.filepath).read_text(encoding="utf-8"))
        except (OSError, ValueError) as why:
            self.report({"ERROR"}, f"{self.filepath}: {why}")
            return {"CANCELLED"}
        put_on_selected(context, material_of(pearl))
        return {"FINISHED"}


def menu(self, context):
    self.layout.operator(ImportPearl.bl_idname, text="Pearl (.py)")


def register():
    bpy.utils.register_class(ImportPearl)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    bpy.utils.unregister_class(ImportPearl)


if __name__ == "__main__":
    put_on_selected(bpy.context, material_of(json.loads(PEARL)))
