#version 450
// The colour of a pixel under light from everywhere and directional lamps: Lambert's diffuse part, and
// specular reflection with the GGX distribution (Karis 2013, "Real Shading in Unreal Engine 4").

layout(constant_id = 0) const int NUM_DIRECTIONAL_LIGHTS = 0;

layout(set = 0, binding = 0) uniform CameraBuffer {
  mat4 viewMatrix;
  mat4 projectionMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrixInverse;
  float width;
  float height;
} camera;

layout(set = 1, binding = 0) uniform ObjectTransformBuffer {
  mat4 modelMatrix;
} placed;

layout(set = 1, binding = 1) uniform ObjectDataBuffer {
  uvec4 segmentation;  // of the shape, of the body, of the scene
  float transparency;
  int shadeFlat;
} body;

layout(set = 2, binding = 0) uniform MaterialBuffer {
  vec4 emission;
  vec4 baseColor;
  float fresnel;
  float roughness;
  float metallic;
  float transmission;
  float ior;
  float transmissionRoughness;
  int textureMask;
  int padding1;
  vec4 textureTransforms[6];
} material;

// Materials of ours have a texture of colours at most, but SAPIEN binds all of them.
layout(set = 2, binding = 1) uniform sampler2D colorTexture;
layout(set = 2, binding = 2) uniform sampler2D roughnessTexture;
layout(set = 2, binding = 3) uniform sampler2D normalTexture;
layout(set = 2, binding = 4) uniform sampler2D metallicTexture;
layout(set = 2, binding = 5) uniform sampler2D emissionTexture;
layout(set = 2, binding = 6) uniform sampler2D transmissionTexture;

struct PointLight {
  vec4 position;
  vec4 emission;
};

struct DirectionalLight {
  vec4 direction;
  vec4 emission;
};

struct SpotLight {
  vec4 position;
  vec4 direction;
  vec4 emission;
};

layout(set = 3, binding = 0) uniform SceneBuffer {
  vec4 ambientLight;
  PointLight pointLights[10];
  DirectionalLight directionalLights[3];
  SpotLight spotLights[10];
  SpotLight texturedLights[1];
} scene;

layout(location = 0) in vec3 inPosition;
layout(location = 1) in vec3 inNormal;
layout(location = 2) in vec2 inUV;

layout(location = 0) out vec4 outColor;
layout(location = 1) out ivec4 outPositionSegmentation;  // mm in camera axes, number of the body

const float PI = 3.14159265;
const float LEAST = 1e-6;

// What a lamp gives the eye from a surface, for each unit of its emission.
vec3 reflected(vec3 normal, vec3 toEye, vec3 toLamp, vec3 diffuse, vec3 straight, float alpha) {
  vec3 between = normalize(toLamp + toEye);
  float lamp = clamp(dot(normal, toLamp), 0, 1);
  float eye = clamp(dot(normal, toEye), LEAST, 1);
  float facet = clamp(dot(normal, between), LEAST, 1);
  float slant = clamp(dot(toEye, between), LEAST, 1);
  float alpha2 = alpha * alpha;
  float spread = facet * facet * (alpha2 - 1) + 1;
  float k = (alpha + 2 * material.roughness + 1) / 8;
  float hidden = (lamp * (1 - k) + k) * (eye * (1 - k) + k);  // facets by one another
  vec3 fresnel = straight + (1 - straight) * exp2((-5.55473 * slant - 6.98316) * slant);
  vec3 specular = fresnel * alpha2 / clamp(4 * PI * spread * spread * hidden, LEAST, 4 * PI);
  return lamp * (diffuse / PI + specular);
}

void main() {
  vec3 normal = normalize(inNormal);
  vec3 toEye = -normalize(inPosition);
  vec3 albedo = material.baseColor.rgb;
  if ((material.textureMask & 1) != 0) {
    albedo *= texture(colorTexture, inUV).rgb;
  }
  vec3 diffuse = albedo * (1 - material.metallic);
  vec3 straight = mix(vec3(material.fresnel * 0.08), albedo, material.metallic);
  float alpha = material.roughness * material.roughness;
  vec3 color = material.emission.rgb + scene.ambientLight.rgb * albedo;
  for (int i = 0; i < NUM_DIRECTIONAL_LIGHTS; ++i) {
    vec3 toLamp = -(mat3(camera.viewMatrix) * scene.directionalLights[i].direction.xyz);
    color += scene.directionalLights[i].emission.rgb * reflected(normal, toEye, toLamp, diffuse, straight, alpha);
  }
  outColor = vec4(clamp(pow(color, vec3(1 / 2.2)), vec3(0), vec3(1)), 1);
  outPositionSegmentation = ivec4(ivec3(inPosition * 1000), body.segmentation[1]);
}
