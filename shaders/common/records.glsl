// Projected splats: a record of twelve numbers each, one after the other, as most readers need all of one that is
// anywhere in memory; and rows of four numbers beside them, of what few scenes call for. In storage buffers or,
// where the driver's are too small for the scene, in textures: a buffer has a slot, a texture a unit, also where it
// is an image. See renderers/gl/project.py. Flags: TEXTURED, TEXTURE_WIDTH.
//
// Fields of a record:
//   shapes   mean.xy, a, b
//   bounds   c, minor axis, major axis.xy
//   colours  rgb, opacity
#include "common/texels.glsl"

#if HAS_TEXTURED
#define RECORDS_READ(slot) \
    layout(binding = 3) uniform sampler2D shapes; \
    layout(binding = 4) uniform sampler2D bounds; \
    layout(binding = 5) uniform sampler2D colours
#define RECORDS_WRITTEN(slot) \
    layout(rgba32f, binding = 3) writeonly uniform image2D shapes; \
    layout(rgba32f, binding = 4) writeonly uniform image2D bounds; \
    layout(rgba32f, binding = 5) writeonly uniform image2D colours
#define RECORD(field, splat) texelFetch(field, texel_of(splat), 0)
#define WRITE_RECORD(field, splat, row) imageStore(field, texel_of(splat), row)
#define ROWS_READ(slot, unit, Block, array) layout(binding = unit) uniform sampler2D array
#define ROWS_WRITTEN(slot, unit, Block, array) layout(rgba32f, binding = unit) writeonly uniform image2D array
#define ROW(array, index) texelFetch(array, texel_of(index), 0)
#define WRITE_ROW(array, index, row) imageStore(array, texel_of(index), row)
#else
struct SplatRecord {
    vec4 shapes, bounds, colours;
};
#define RECORDS_READ(slot) layout(std430, binding = slot) readonly buffer Records { SplatRecord records[]; }
#define RECORDS_WRITTEN(slot) layout(std430, binding = slot) writeonly buffer Records { SplatRecord records[]; }
#define RECORD(field, splat) records[splat].field
#define WRITE_RECORD(field, splat, row) records[splat].field = row
#define ROWS_READ(slot, unit, Block, array) layout(std430, binding = slot) readonly buffer Block { vec4 array[]; }
#define ROWS_WRITTEN(slot, unit, Block, array) layout(std430, binding = slot) writeonly buffer Block { vec4 array[]; }
#define ROW(array, index) array[index]
#define WRITE_ROW(array, index, row) array[index] = row
#endif
