"""Blender add-on for srf: File > Import > srf rest model, File > Export > srf skin.

Works in Blender 3.4 to 5.0; install it by Edit > Preferences > Add-ons > Install, or call import_rest and export_skin
from a script. The rest model comes from

    srf model X.srf --export rest.glb

and what is exported goes into a scene as {"type": "skin", "file": "posed.glb"}. Every vertex carries its number in the
attribute _SRF_INDEX and in u of the second UV map: leave both alone, and neither add nor remove vertices. The frames
are Blender's own, if the scene of srf has the same "fps".
"""
import bpy
import numpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

bl_info = {
    "name": "srf: deformable reflectance fields",
    "blender": (3, 4, 0),
    "category": "Import-Export",
    "location": "File > Import, File > Export",
    "description": "Brings a captured model here to be rigged and animated, and its motion back",
}

INDEX = "_SRF_INDEX"

if "bool" not in vars(numpy):
    numpy.bool = bool  # the importer of 3.4 asks for it, numpy 1.24 has dropped it


def known(operator, **settings):
    """Those of the settings that this Blender's operator has."""
    properties = operator.get_rna_type().properties.keys()
    return {name: value for name, value in settings.items() if name in properties}


def import_rest(path):
    """The mesh object of a file that srf model --export wrote."""
    before = set(bpy.data.objects)
    operator = bpy.ops.import_scene.gltf
    operator(filepath=str(path), **known(operator, import_shading="NORMALS", merge_vertices=False))
    mesh_object = next(o for o in bpy.data.objects if o not in before and o.type == "MESH")
    mesh = mesh_object.data
    if INDEX not in mesh.attributes:  # 3.4 drops attributes, and keeps UV maps
        index = numpy.zeros(len(mesh.vertices), numpy.float32)
        uv = numpy.zeros(2 * len(mesh.loops), numpy.float32)
        corner = numpy.zeros(len(mesh.loops), numpy.int32)
        mesh.uv_layers[1].data.foreach_get("uv", uv)
        mesh.loops.foreach_get("vertex_index", corner)
        index[corner] = uv[::2]
        mesh.attributes.new(INDEX, "FLOAT", "POINT").data.foreach_set("value", index)
    return mesh_object


def export_skin(path, mesh_object):
    """Writes the mesh, the armature that bends it, its shape keys and their animation, cameras and lights."""
    for o in bpy.context.view_layer.objects:
        o.select_set(o == mesh_object or o == mesh_object.find_armature() or o.type in {"CAMERA", "LIGHT"})
    operator = bpy.ops.export_scene.gltf
    operator(filepath=str(path), **known(
        operator, export_format="GLB", use_selection=True, export_yup=True,
        export_attributes=True, export_texcoords=True, export_normals=True, export_materials="NONE",
        export_apply=False, export_skins=True, export_all_influences=True, export_morph=True,
        export_cameras=True, export_lights=True, export_import_convert_lighting_mode="RAW",
        # One animation with everything in it, a key at each frame, and frame f at f / fps seconds.
        export_animations=True, export_animation_mode="SCENE", export_anim_scene_split_object=False,
        export_force_sampling=True, export_frame_range=True, export_anim_slide_to_zero=False,
        export_optimize_animation_size=False, export_nla_strips=False, export_current_frame=False,
        export_draco_mesh_compression_enable=False))


class ImportRest(bpy.types.Operator, ImportHelper):
    bl_idname = "import_scene.srf_rest"
    bl_label = "srf rest model (.glb)"
    filename_ext = ".glb"

    def execute(self, context):
        context.view_layer.objects.active = import_rest(self.filepath)
        return {"FINISHED"}


class ExportSkin(bpy.types.Operator, ExportHelper):
    bl_idname = "export_scene.srf_skin"
    bl_label = "srf skin (.glb)"
    filename_ext = ".glb"

    @classmethod
    def poll(cls, context):
        return context.active_object is not None and context.active_object.type == "MESH"

    def execute(self, context):
        export_skin(self.filepath, context.active_object)
        return {"FINISHED"}


def import_entry(menu, _context):
    menu.layout.operator(ImportRest.bl_idname)


def export_entry(menu, _context):
    menu.layout.operator(ExportSkin.bl_idname)


def register():
    for each in (ImportRest, ExportSkin):
        bpy.utils.register_class(each)
    bpy.types.TOPBAR_MT_file_import.append(import_entry)
    bpy.types.TOPBAR_MT_file_export.append(export_entry)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(import_entry)
    bpy.types.TOPBAR_MT_file_export.remove(export_entry)
    for each in (ExportSkin, ImportRest):
        bpy.utils.unregister_class(each)


if __name__ == "__main__":
    register()
